"""The pictures of captures in ``docs/styles.md``, written into ``docs/pictures``.

``python -m tests.benchmarks.style_grid``: four captures fitted at 384 pixels, the middle view of each; the paintings
that come with the package and the first by name of the test data, and eight texts; above ``method=branch``, below
``method=brush``. Nothing was chosen after looking.
"""

from pathlib import Path

import torch
from PIL import Image

import anystyle
from anystyle.data.images import read_image
from anystyle.examples import examples, resolved
from anystyle.io.sheet import to_pil
from anystyle.methods.branch import Branch
from anystyle.types import Style
from anystyle_methods.brush import Brush
from tests.benchmarks.style_quality import CAPTURES, fitted
from tests.support.real_data import ROOT

TEXTS = (
    "an impressionist meadow in green and ochre with short brushstrokes", "navy and gold", "a charcoal drawing",
    "watercolour of a sunset", "stained glass", "bold swirls in red and orange", "steampunk brass", "a raven's wing",
)  # fmt: skip
WIDTH, GAP = 176, 3
OUT = Path(__file__).parents[2] / "docs" / "pictures"


@torch.no_grad()
def main() -> None:
    stylizer = anystyle.load("painter")
    known = [name for name, example in examples().items() if example.file.endswith(".jpg")]
    files = [*(resolved(Path(f"example:{name}")) for name in known), min((ROOT / "paintings").glob("*.jpg"))]
    kinds = {
        "paintings": [Style(read_image(file)[None]) for file in files],
        "texts": [Style(text=(text,)) for text in TEXTS],
    }
    rows: dict[str, list[list[Image.Image]]] = {kind: [] for kind in kinds}
    for path in CAPTURES["captures"]:
        scene = fitted(ROOT / path, stylizer, 384)
        middle = scene.cameras.select([scene.cameras.intrinsics.shape[1] // 2])
        for method in (Branch(), Brush()):
            for kind, styles in kinds.items():
                row = [stylizer.unstyled(scene)]
                for style in styles:
                    given = {"text": style.text} if style.image is None else {"image": style.image}
                    row.append(method(stylizer, scene, style, stylizer.embed(**given)))
                rows[kind].append([to_pil(stylizer.render(one, middle).color[0, 0]) for one in row])
    for kind, cells in rows.items():
        head = [read_image(file) for file in files[:-1]] if kind == "paintings" else []
        grid(cells, [to_pil(image) for image in head]).save(OUT / f"styles_{kind}.jpg", quality=85)


def grid(cells: list[list[Image.Image]], head: list[Image.Image]) -> Image.Image:
    """Rows of pictures of one width, below pictures for the columns after the first."""
    tops = [WIDTH * 3 // 4] if head else []
    heights = [*tops, *(round(row[0].height * WIDTH / row[0].width) for row in cells)]
    columns = len(cells[0])
    sheet = Image.new("RGB", (columns * (WIDTH + GAP) - GAP, sum(heights) + GAP * (len(heights) - 1)), "white")
    for column, image in enumerate(head, start=1):
        image.thumbnail((WIDTH, heights[0]))
        sheet.paste(image, (column * (WIDTH + GAP) + (WIDTH - image.width) // 2, heights[0] - image.height))
    top = sum(tops) + GAP * len(tops)
    for row, height in zip(cells, heights[len(tops) :], strict=True):
        for column, image in enumerate(row):
            sheet.paste(image.resize((WIDTH, height), Image.Resampling.LANCZOS), (column * (WIDTH + GAP), top))
        top += height + GAP
    return sheet


if __name__ == "__main__":
    main()
