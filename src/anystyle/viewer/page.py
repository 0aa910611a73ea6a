"""viser's page with what it lacks: a drop of pictures, a row of styles with their pictures, and the line of a split."""

import base64
import hashlib
import io
import re
import tempfile
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from PIL import Image

from anystyle.data.images import open_image
from anystyle.errors import one_line


def page(viser_page: Path, largest: int) -> bytes:
    """The page of viser with our script and style sheet.

    Args:
        viser_page: Its HTML.
        largest: Bytes that a picture may have.
    """
    folder = files("anystyle.viewer")
    script = Template(folder.joinpath("page.js").read_text(encoding="utf-8")).safe_substitute(largest=largest)
    head = f"<script>\n{script}</script>\n<style>\n{folder.joinpath('page.css').read_text(encoding='utf-8')}</style>\n"
    before, title, after = viser_page.read_text(encoding="utf-8").partition("<title>Viser</title>")
    return f"{before}{title.replace('Viser', 'anystyle')}\n{head}{after}".encode()


def row(styles: Sequence[str], shown: str, pictures: Mapping[str, str]) -> str:
    """Buttons for styles, as HTML.

    Args:
        styles: The newest first.
        shown: The one that is looked at.
        pictures: Addresses of pictures of the scene in a style.
    """
    return f'<div class="anystyle-row">{"".join(_button(style, style == shown, pictures) for style in styles)}</div>'


def _button(style: str, pressed: bool, pictures: Mapping[str, str]) -> str:
    picture = f'<img alt="" src="{pictures[style]}">' if style in pictures else "<i></i>"
    title = name_of(style) or "unstyled"
    return (
        f'<button type="button" data-style="{escape(style)}" aria-pressed="{str(pressed).lower()}" '
        f'title="{escape(title)}">{picture}<span>{escape(title)}</span></button>'
    )


def name_of(style: str) -> str:
    """A style for people: pictures that were given have the beginnings of their digests behind their names."""
    return re.sub(r"(-[0-9a-f]{8})?\.png$", "", Path(style).name) if style.endswith(".png") else style[:60]


def address(picture: Image.Image) -> str:
    """A picture as an address that holds it."""
    data = io.BytesIO()
    picture.convert("RGB").save(data, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"


LARGEST = 32 * 1024 * 1024
"""Bytes of a picture."""
LONGEST = 2048
"""Pixels of the longer side; larger pictures are reduced to less than twice of it."""


def keep_picture(folder: Path, name: str, content: bytes) -> Path:
    """Keep a picture under its name and the beginning of its digest.

    Args:
        folder: Where to; it is made.
        name: As the browser says it.
        content: The file.

    Raises:
        ValueError: It is too large, or none.
    """
    if len(content) > LARGEST:
        raise ValueError(f"a picture of {len(content):,} bytes; at most {LARGEST:,} are taken")
    stem = "".join(letter if letter.isalnum() else "-" for letter in Path(name).stem)[:40] or "picture"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile(dir=folder, prefix=".given-") as file:
        file.write(content)
        file.flush()
        try:
            picture = open_image(Path(file.name), longest=LONGEST)
        except (ValueError, OSError) as error:
            raise ValueError(one_line(error).replace(file.name, f"the picture {stem}")) from None
    target = folder / f"{stem}-{hashlib.sha256(content).hexdigest()[:8]}.png"
    picture.save(target)
    return target
