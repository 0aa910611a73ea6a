"""Contact sheets: images in rows and columns under titles, on white."""

import base64
import io
import textwrap
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageOps
from torch import Tensor

from anystyle.io.fonts import lettered
from anystyle.io.images import check_pillow

INK = (28, 28, 30)
FAINT = (120, 120, 128)
CARD = (242, 242, 246)
CELL = 224
"""Longer side of a cell in pixels."""


@dataclass(frozen=True)
class TextCard:
    """A cell that shows words, such as a style given as text."""

    text: str


Cell = Image.Image | TextCard | None


def to_pil(image: Float[Tensor, "3 H W"]) -> Image.Image:
    """An sRGB image in [0, 1] as an 8-bit one, rounded to nearest."""
    pixels = image.detach().clamp(0, 1).mul_(255).round_().byte().permute(1, 2, 0).cpu().numpy()
    return Image.fromarray(np.ascontiguousarray(pixels))


def data_url(picture: Image.Image, kind: str, **options: int) -> str:
    """A picture as a ``data:`` URL; ``options`` are Pillow's for the kind of file, such as ``jpeg``."""
    data = io.BytesIO()
    picture.convert("RGB").save(data, kind, **options)
    return f"data:image/{kind};base64,{base64.b64encode(data.getvalue()).decode()}"


def contact_sheet(
    rows: Sequence[Sequence[Cell]],
    *,
    column_titles: Sequence[str] = (),
    row_titles: Sequence[str] = (),
    footer: str = "",
    cell: tuple[int, int] = (CELL, CELL),
    gap: int = 10,
) -> Image.Image:
    """Lay out rows of as many cells in a grid, with titles over columns and left of rows and a line under all.

    Every image is fitted into a cell of width and height ``cell``, its aspect kept; ``None`` leaves a cell empty.
    """
    if not rows or not rows[0] or len({len(row) for row in rows}) != 1:
        raise ValueError("a contact sheet needs rows of one length, with at least one cell")
    width, height = cell
    titles = [wrap(title, 15, width, max_lines=3) for title in column_titles]
    left = gap + (130 if any(row_titles) else 0)
    top = gap + (max(19 * title.count("\n") + 25 for title in titles) if any(titles) else 0)
    bottom = gap + (22 if footer else 0)
    size = (left + len(rows[0]) * (width + gap), top + len(rows) * (height + gap) - gap + bottom)
    sheet = Image.new("RGB", size, "white")
    draw = ImageDraw.Draw(sheet)
    for column, title in enumerate(titles):
        at = (left + column * (width + gap) + width / 2, top - 6)
        draw.multiline_text(at, title, fill=INK, font=lettered(title, 15)[1], anchor="md", align="center")
    for index, row in enumerate(rows):
        y = top + index * (height + gap)
        if index < len(row_titles):
            text = wrap(row_titles[index], 15, 120, max_lines=4)
            at, font = (left - 10, y + height / 2), lettered(text, 15)[1]
            draw.multiline_text(at, text, fill=INK, font=font, anchor="rm", align="right")
        for column, content in enumerate(row):
            _paste(sheet, draw, content, (left + column * (width + gap), y), cell)
    if footer:
        line = wrap(footer, 12, sheet.width - 2 * gap, max_lines=1)
        draw.text((gap, sheet.height - gap), line, fill=FAINT, font=lettered(line, 12)[1], anchor="ld")
    return sheet


def shown(number: int) -> list[int]:
    """Which of a number of views a sheet shows: at most four, evenly spaced."""
    return np.linspace(0, number - 1, min(4, number)).round().astype(int).tolist()


def thumbnails(views: Sequence[Image.Image]) -> list[Image.Image]:
    """Those of the views of a scene that a sheet shows, of the size of its cells."""
    return [ImageOps.contain(views[place], (CELL, CELL), Image.Resampling.LANCZOS) for place in shown(len(views))]


def style_sheet(
    views: Sequence[Image.Image], columns: Sequence[tuple[str, Cell, Sequence[Cell]]], *, title: str = "photograph"
) -> Image.Image:
    """Thumbnails of views, and for each column its title, style if it has one, and thumbnails below."""
    titles, head, *_ = zip((title, None, views), *columns, strict=True)
    rows = list(zip(views, *(renders for *_, renders in columns), strict=True))
    cell = max(view.width for view in views), max(view.height for view in views)
    return contact_sheet([*([head] if any(head) else []), *rows], column_titles=titles, cell=cell)


def save_png(image: Image.Image, path: Path) -> None:
    """Write an image as a PNG file."""
    check_pillow()
    # For a painted view: 2 % larger than with zlib's default, in a fifth of the time.
    image.save(path, compress_level=1, compress_type=zlib.Z_RLE)


def wrap(text: str, size: int, width: int, max_lines: int) -> str:
    """Break text in a font of a size into lines no wider than ``width`` pixels; the rest becomes an ellipsis.

    Letters that no font has are left out.
    """
    text, font = lettered(text, size)
    for letters in range(width // 3, 1, -1):
        lines = textwrap.wrap(text, letters, max_lines=max_lines, placeholder="…")
        if all(font.getlength(line) <= width for line in lines):
            return "\n".join(lines)
    return "…"


def _paste(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, content: Cell, corner: tuple[int, int], cell: tuple[int, int]
) -> None:
    (x, y), (width, height) = corner, cell
    if isinstance(content, TextCard):
        draw.rounded_rectangle((x, y, x + width, y + height), radius=8, fill=CARD)
        words = wrap(f"“{content.text.strip()}”", 17, width - 28, max_lines=max(1, (height - 20) // 24))
        middle = (x + width / 2, y + height / 2)
        font = lettered(words, 17)[1]
        draw.multiline_text(middle, words, fill=INK, font=font, anchor="mm", align="center", spacing=6)
    elif content is not None:
        picture = ImageOps.contain(content.convert("RGB"), cell, Image.Resampling.LANCZOS)
        sheet.paste(picture, (x + (width - picture.width) // 2, y + (height - picture.height) // 2))
