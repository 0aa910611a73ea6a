"""Fonts for titles: Pillow's own for plain text, and DejaVu, which matplotlib brings along, for other letters."""

import logging
import unicodedata
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from PIL import Image, ImageDraw, ImageFont

_log = logging.getLogger(__name__)

Font = ImageFont.FreeTypeFont | ImageFont.ImageFont


def lettered(text: str, size: int) -> tuple[str, Font]:
    """A text, and the first font of a size in pixels that has all its letters, or else the last.

    Letters that it does not have lose their accents or are left out, marks of others with them, which a warning says
    once.
    """
    text = unicodedata.normalize("NFC", text)
    marks = {letter for letter in text if unicodedata.category(letter).startswith("M")}
    letters = {letter for letter in text if not letter.isspace()} - marks
    fonts = _fonts(size)
    font = next((font for font in fonts if all(_has(font, letter) for letter in letters)), fonts[-1])
    if missing := [letter for letter in letters if not _has(font, letter)]:
        _tell()
        plain = {letter: unicodedata.normalize("NFKD", letter)[0] for letter in missing}
        kept = {ord(letter): other if _has(font, other) else None for letter, other in plain.items()}
        text = " ".join(text.translate(kept | dict.fromkeys(map(ord, marks))).split()) or "?"
    return text, font


@cache
def _fonts(size: int) -> list[Font]:
    fonts: list[Font] = [ImageFont.load_default(size=size)]
    found = find_spec("matplotlib")
    if found is not None and found.origin is not None:
        file = Path(found.origin).parent / "mpl-data" / "fonts" / "ttf" / "DejaVuSans.ttf"
        fonts += [ImageFont.truetype(file, size)] if file.is_file() else []
    return fonts


@cache
def _has(font: Font, letter: str) -> bool:
    """Whether a font draws a letter otherwise than one that no font has."""
    return _drawn(font, letter) != _drawn(font, "\U0010ffff")


def _drawn(font: Font, letter: str) -> bytes:
    image = Image.new("L", (32, 32))
    ImageDraw.Draw(image).text((8, 4), letter, fill=255, font=font)
    return image.tobytes()


@cache
def _tell() -> None:
    _log.warning(
        "letters of other scripts than DejaVu Sans has are left out of the sheet; report.json has the titles whole. "
        'pip install "anystyle[report]" brings this font along'
    )
