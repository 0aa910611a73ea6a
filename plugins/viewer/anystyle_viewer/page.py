"""Additions to viser's page: dropped images, a row of styles with thumbnails, and the line of a split view."""

import base64
import hashlib
import io
import re
from collections.abc import Mapping, Sequence
from html import escape
from importlib.resources import files
from pathlib import Path

from PIL import Image

from anystyle.data.images import open_image
from anystyle.errors import UserError

MAX_UPLOAD = 32 * 1024 * 1024
"""Bytes of an uploaded image."""
MAX_SIDE = 2048
"""Pixels; the longer side of larger images is reduced to less than twice of it."""


def page(viser_page: Path) -> bytes:
    """The HTML page of viser with the script and style sheet of this package."""
    folder = files("anystyle_viewer")
    script, css = (folder.joinpath(f"page.{suffix}").read_text(encoding="utf-8") for suffix in ("js", "css"))
    script = script.replace("$largest", str(MAX_UPLOAD))
    head = f"<title>anystyle</title>\n<script>\n{script}</script>\n<style>\n{css}</style>\n"
    return viser_page.read_text(encoding="utf-8").replace("<title>Viser</title>", head).encode()


def style_row(styles: Sequence[str], current: str, thumbnails: Mapping[str, str]) -> str:
    """Buttons for styles, as HTML; ``thumbnails`` are URLs of images by style."""
    buttons = ""
    for style in styles:
        image = f'<img alt="" src="{thumbnails[style]}">' if style in thumbnails else "<i></i>"
        title, pressed = escape(title_of(style) or "unstyled"), str(style == current).lower()
        attributes = f'data-style="{escape(style)}" aria-pressed="{pressed}" title="{title}"'
        buttons += f'<button type="button" {attributes}>{image}<span>{title}</span></button>'
    return f'<div class="anystyle-row">{buttons}</div>'


def title_of(style: str) -> str:
    """A style as a title; the file of an uploaded image loses its path, suffix and hash."""
    return re.sub(r"(-[0-9a-f]{8})?\.png$", "", Path(style).name) if style.endswith(".png") else style[:60]


def data_url(image: Image.Image) -> str:
    """An image as a ``data:`` URL."""
    data = io.BytesIO()
    image.convert("RGB").save(data, "JPEG", quality=85)
    return f"data:image/jpeg;base64,{base64.b64encode(data.getvalue()).decode()}"


def store_upload(folder: Path, name: str, content: bytes) -> Path:
    """Store an uploaded image as PNG under its name and the first digits of its hash; a UserError refuses it."""
    if len(content) > MAX_UPLOAD:
        raise UserError(f"an image of {len(content):,} bytes; at most {MAX_UPLOAD:,} are accepted")
    stem = "".join(letter if letter.isalnum() else "-" for letter in Path(name).stem)[:40] or "image"
    image = open_image(content, f"the image {stem}", longest=MAX_SIDE)
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / f"{stem}-{hashlib.sha256(content).hexdigest()[:8]}.png"
    image.save(target)
    return target
