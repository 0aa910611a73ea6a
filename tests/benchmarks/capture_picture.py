"""The second picture of the README, written into ``docs/pictures``; run it with ``PYTHONPATH=tests``.

A real capture, 20 frames of KITTI-360 (Liao, Xie and Geiger 2022), whose licence lets adaptations be shown under the
same terms; the paintings are in the public domain. Renders alone are shown, of views evenly spaced.
"""

from pathlib import Path

from PIL import Image

import anystyle
from anystyle.io.sheet import contact_sheet, to_pil
from anystyle.pipeline.options import ViewOptions
from real_data import ROOT

CAPTURE, NUM_VIEWS = "videos/kitti360.mp4", 20
ROWS = (0, 9, 19)
TEXTS = ("thick oil paint in orange and navy", "charcoal drawing", "pink and mint watercolor")
PAINTINGS = {
    "Hokusai, The Great Wave": "painting_086.jpg",
    "Van Gogh, The Starry Night": "painting_088.jpg",
    "Monet, Water Lilies": "painting_077.jpg",
    "Munch, The Scream": "painting_076.jpg",
}
SIDE = 192
OUT = Path(__file__).parents[2] / "docs" / "pictures" / "capture.jpg"


def main() -> None:
    styles = [*TEXTS, *(ROOT / "paintings" / name for name in PAINTINGS.values())]
    results = anystyle.stylize(ROOT / CAPTURE, styles, views=ViewOptions(take=NUM_VIEWS))
    titles = ["unstyled", *(f"“{text}”" for text in TEXTS), *PAINTINGS]
    columns = [results.unstyled[2], *([to_pil(image) for image in result.render()] for result in results)]
    rows: list[list[Image.Image]] = [[column[view] for column in columns] for view in ROWS]
    first = rows[0][0]
    cell = (SIDE, round(SIDE * first.height / first.width))
    contact_sheet(rows, column_titles=titles, cell=cell, gap=4).save(OUT, quality=88)


if __name__ == "__main__":
    main()
