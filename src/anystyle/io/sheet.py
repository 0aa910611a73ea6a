"""Contact sheets: images in rows and columns under titles, on white."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from PIL import Image, ImageDraw, ImageFont
from torch import Tensor

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
    pixels = (image.detach().clamp(0, 1) * 255).round().byte().permute(1, 2, 0).cpu().numpy()
    return Image.fromarray(np.ascontiguousarray(pixels))


def contact_sheet(
    rows: Sequence[Sequence[Cell]],
    *,
    column_titles: Sequence[str] = (),
    row_titles: Sequence[str] = (),
    footer: str = "",
    cell: tuple[int, int] = (CELL, CELL),
    gap: int = 10,
) -> Image.Image:
    """Lay out cells in a grid.

    Args:
        rows: Cells, row by row; all rows have the same number of columns, ``None`` leaves a cell empty.
        column_titles: Words over the columns.
        row_titles: Words left of the rows.
        footer: A line under all, such as where a figure comes from.
        cell: Width and height that every image is fitted into, its aspect kept.
        gap: Pixels between cells.

    Raises:
        ValueError: There is no cell, or rows differ in length.
    """
    if not rows or not rows[0] or len({len(row) for row in rows}) != 1:
        raise ValueError("a contact sheet needs rows of one length, with at least one cell")
    font = ImageFont.load_default(size=15)
    width, height = cell
    left = gap + (130 if any(row_titles) else 0)
    top = gap + (_lines_height(column_titles, font, width) + 6 if any(column_titles) else 0)
    bottom = gap + (22 if footer else 0)
    sheet = Image.new(
        "RGB", (left + len(rows[0]) * (width + gap), top + len(rows) * (height + gap) - gap + bottom), "white"
    )
    draw = ImageDraw.Draw(sheet)
    for column, title in enumerate(column_titles):
        text = wrap(title, font, width, max_lines=3)
        anchor = (left + column * (width + gap) + width / 2, top - 6)
        draw.multiline_text(anchor, text, fill=INK, font=font, anchor="md", align="center")
    for index, row in enumerate(rows):
        y = top + index * (height + gap)
        if index < len(row_titles):
            text = wrap(row_titles[index], font, 120, max_lines=4)
            draw.multiline_text((left - 10, y + height / 2), text, fill=INK, font=font, anchor="rm", align="right")
        for column, content in enumerate(row):
            _paste(sheet, draw, content, (left + column * (width + gap), y), cell)
    if footer:
        small = ImageFont.load_default(size=12)
        line = wrap(footer, small, sheet.width - 2 * gap, max_lines=1)
        draw.text((gap, sheet.height - gap), line, fill=FAINT, font=small, anchor="ld")
    return sheet


def style_sheet(
    photographs: Sequence[Image.Image], columns: Sequence[tuple[str, Cell, Sequence[Cell]]], *, rows: int = 4
) -> Image.Image:
    """Photographs on the left, then for each column its style on top and its renders below.

    Args:
        photographs: The input views, all of one size.
        columns: Title, style image if there is one, and one render for each photograph.
        rows: At most so many views, evenly spaced.
    """
    count = min(rows, len(photographs))
    shown = [round(row * (len(photographs) - 1) / max(count - 1, 1)) for row in range(count)]
    head: list[list[Cell]] = [[None, *(style for _, style, _ in columns)]]
    body: list[list[Cell]] = [[photographs[view], *(renders[view] for _, _, renders in columns)] for view in shown]
    aspect = photographs[0].width / photographs[0].height
    return contact_sheet(
        [*(head if any(head[0]) else []), *body],
        column_titles=["photograph", *(title for title, _, _ in columns)],
        cell=(CELL, round(CELL / aspect)) if aspect >= 1 else (round(CELL * aspect), CELL),
    )


def wrap(text: str, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, width: int, max_lines: int) -> str:
    """Break text into lines no wider than ``width`` pixels; what is too long ends in an ellipsis."""
    lines: list[str] = []
    rest = " ".join(text.split())
    while rest and len(lines) < max_lines:
        count = _fitting(rest, font, width)
        if count < len(rest) and len(lines) == max_lines - 1:
            while count > 1 and font.getlength(rest[:count] + "…") > width:
                count -= 1
            return "\n".join([*lines, rest[:count].rstrip() + "…"])
        space = rest.rfind(" ", 0, count + 1) if count < len(rest) else -1
        count = space if space > 0 else count
        lines.append(rest[:count].rstrip())
        rest = rest[count:].lstrip()
    return "\n".join(lines)


def _fitting(text: str, font: ImageFont.ImageFont | ImageFont.FreeTypeFont, width: int) -> int:
    count = 1
    while count < len(text) and font.getlength(text[: count + 1]) <= width:
        count += 1
    return count


def _lines_height(titles: Sequence[str], font: ImageFont.ImageFont | ImageFont.FreeTypeFont, width: int) -> int:
    return 19 * max((wrap(title, font, width, max_lines=3).count("\n") + 1 for title in titles), default=0)


def _paste(
    sheet: Image.Image, draw: ImageDraw.ImageDraw, content: Cell, corner: tuple[int, int], cell: tuple[int, int]
) -> None:
    (x, y), (width, height) = corner, cell
    match content:
        case None:
            return
        case TextCard(text):
            font = ImageFont.load_default(size=17)
            draw.rounded_rectangle((x, y, x + width, y + height), radius=8, fill=CARD)
            words = wrap(f"“{text.strip()}”", font, width - 28, max_lines=max(1, (height - 20) // 24))
            draw.multiline_text(
                (x + width / 2, y + height / 2), words, fill=INK, font=font, anchor="mm", align="center", spacing=6
            )
        case Image.Image():
            scale = min(width / content.width, height / content.height)
            size = (max(1, round(content.width * scale)), max(1, round(content.height * scale)))
            picture = content.convert("RGB").resize(size, Image.Resampling.LANCZOS)
            sheet.paste(picture, (x + (width - size[0]) // 2, y + (height - size[1]) // 2))
