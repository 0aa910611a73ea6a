"""Fonts for text of any script, among those that this machine has."""

import logging
import unicodedata
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

_log = logging.getLogger(__name__)
DEFAULT = ""
"""Pillow's own font, of ASCII and punctuation alone."""
FILES = (
    *("DejaVuSans.ttf", "NotoSans-Regular.ttf", "Arial Unicode.ttf", "arial.ttf", "Arial.ttf", "segoeui.ttf"),
    *("NotoSansCJK-Regular.ttc", "NotoSansCJKsc-Regular.otf", "SourceHanSansSC-Regular.otf", "wqy-microhei.ttc"),
    *("wqy-zenhei.ttc", "DroidSansFallbackFull.ttf", "DroidSansFallback.ttf", "PingFang.ttc", "Hiragino Sans GB.ttc"),
    *("msyh.ttc", "YuGothM.ttc", "malgun.ttf", "NotoSansDevanagari-Regular.ttf", "Nirmala.ttf", "Nirmala.ttc"),
    *("NotoSansHebrew-Regular.ttf", "NotoSansArabic-Regular.ttf", "NotoSansThai-Regular.ttf", "LeelawUI.ttf"),
    *("Symbola.ttf", "NotoEmoji-Regular.ttf", "seguiemj.ttf", "seguisym.ttf"),
)
"""Fonts of Linux, macOS and Windows, in the order in which they are looked for."""

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def lettered(text: str, size: int) -> tuple[str, Font]:
    """A text, and the font of a size in pixels that has most of its letters; Pillow's own where that has all.

    Letters that no font has lose their accents or are left out, which a warning says once.
    """
    text, file = unicodedata.normalize("NFC", text), DEFAULT
    letters = {letter for letter in text if not (letter.isspace() or _is_mark(letter))}
    if not all(_has(DEFAULT, letter) for letter in letters):
        file = max(_files(), key=lambda file: sum(_has(file, letter) for letter in letters))
    if not all(_has(file, letter) for letter in letters):
        _tell()
        text = " ".join("".join(_drawable(file, cluster) for cluster in _clusters(text)).split()) or "?"
    font = _font(file, size)
    assert font is not None
    return text, font


def _clusters(text: str) -> list[str]:
    """Letters, each with the marks that follow it: vowels of Devanagari, accents that no single letter has."""
    clusters: list[str] = []
    for letter in text:
        if clusters and _is_mark(letter):
            clusters[-1] += letter
        else:
            clusters.append(letter)
    return clusters


def _is_mark(letter: str) -> bool:
    return unicodedata.category(letter).startswith("M")


def _drawable(file: str, cluster: str) -> str:
    """A letter with its marks if a font has it, else what it has of the letter without them."""
    if cluster[0].isspace() or _has(file, cluster[0]):
        return cluster
    return "".join(c for c in unicodedata.normalize("NFKD", cluster) if not _is_mark(c) and _has(file, c))


@cache
def _files() -> list[str]:
    """The fonts that are there; matplotlib brings one of them along."""
    found = find_spec("matplotlib")
    own = [] if found is None or found.origin is None else [Path(found.origin).parent / "mpl-data/fonts/ttf" / FILES[0]]
    return [file for file in (DEFAULT, *map(str, own), *FILES) if _font(file, 15) is not None]


@cache
def _font(file: str, size: int) -> Font | None:
    if file == DEFAULT:
        return ImageFont.load_default(size=size)
    with suppress(OSError):
        return ImageFont.truetype(file, size)
    return None


@cache
def _has(file: str, letter: str) -> bool:
    """Whether a font draws a letter otherwise than one that no font has."""
    return _drawn(file, letter) != _drawn(file, "\U0010ffff")


def _drawn(file: str, letter: str) -> bytes:
    image = Image.new("L", (32, 32))
    ImageDraw.Draw(image).text((8, 4), letter, fill=255, font=_font(file, 15))
    return image.tobytes()


@cache
def _tell() -> None:
    _log.warning(
        "no font of this machine has all letters of the titles, and those are left out of the sheet; report.json has "
        "the titles whole. A font such as Noto Sans CJK helps"
    )
