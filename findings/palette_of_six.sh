#!/usr/bin/env bash
# The palette of a picture of six colours, by four packages: white is missing, a colour is invented, red is not seen.
#
# Palettes of styles are taken by these. 300 x 200 pixels, six stripes: white, navy, red, ochre, green, black.
#   colorthief 0.2.1          of six asked for: five, and (72, 56, 128), which is nowhere. White, all above 250, is left
#                             out. Of 2 asked for come 3, of 3 come 4
#     columns navy and red,   navy alone, several times: it takes each tenth pixel, which are columns 0, 10, ... of a
#     by turns                width of 300; quality=1 takes all
#     one third red and navy  red, for it is more than navy; red and navy again and again for the rest; never white
#   Pylette 6.0.0, MedianCut  (77, 30, 53), which is nowhere, with a share of 0.5; green twice; four are missing
#           KMeans (default)  the six
#   haishoku 1.1.8            the six, and two of nothing
#   extcolors 1.0.0           the six, exactly
# No warning.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet colorthief==0.2.1 Pylette==6.0.0 haishoku==1.1.8 extcolors==1.0.0 numpy==2.4.6 \
    pillow==12.3.0
env/bin/python - <<'PYTHON'
import extcolors
import numpy as np
from colorthief import ColorThief
from haishoku.haishoku import Haishoku
from PIL import Image
from pylette import extract_colors

COLOURS = {
    "white": (255, 255, 255),
    "navy": (20, 40, 120),
    "red": (200, 40, 30),
    "ochre": (210, 160, 60),
    "green": (40, 120, 70),
    "black": (10, 10, 10),
}


def save(names, name):
    row = np.array([COLOURS[colour] for colour in names], np.uint8)
    Image.fromarray(np.broadcast_to(row, (200, 300, 3)).copy()).save(name)
    return name


def named(colour):
    name = min(COLOURS, key=lambda name: np.abs(np.subtract(COLOURS[name], colour)).max())
    return name if np.abs(np.subtract(COLOURS[name], colour)).max() <= 6 else tuple(int(value) for value in colour)


def thief(picture, count=6, **options):
    return [named(colour) for colour in ColorThief(picture).get_palette(color_count=count, **options)]


stripes = save([colour for colour in COLOURS for _ in range(50)], "stripes.png")
columns = save(["navy", "red"] * 150, "columns.png")
paper = save(["white"] * 200 + ["navy"] * 40 + ["red"] * 60, "paper.png")

found = thief(stripes)
print("colorthief, stripes", found)
assert found[:5] == ["navy", "ochre", "green", "red", "black"] and found[5:] == [(72, 56, 128)]
assert [len(thief(stripes, count)) for count in (2, 3, 5, 6)] == [3, 4, 5, 6]
print("colorthief, columns", thief(columns), "all pixels", thief(columns, quality=1))
assert set(thief(columns)) == {"navy"} and {"navy", "red"} <= set(thief(columns, quality=1))
print("colorthief, paper", named(ColorThief(paper).get_color()), thief(paper))
assert named(ColorThief(paper).get_color()) == "red" and "white" not in thief(paper)

for mode in ("MedianCut", "KMeans"):
    found = extract_colors(stripes, palette_size=6, mode=mode)
    palette = [(named(colour.rgb), round(float(colour.frequency), 2)) for colour in found]
    print("Pylette,", mode, palette)
    names = [name for name, _ in palette]
    if mode == "KMeans":
        assert set(names) == set(COLOURS)
    else:
        assert palette[0] == ((77, 30, 53), 0.5) and names.count("green") == 2
        assert not {"white", "navy", "red", "black"} & set(names)
palette = [named(colour) for _, colour in Haishoku.getPalette(stripes)]
print("haishoku", palette)
assert len(palette) == 8 and set(COLOURS) < set(palette)
palette = [(named(colour), count) for colour, count in extcolors.extract_from_path(stripes)[0]]
print("extcolors", palette)
assert sorted(palette) == sorted((name, 10000) for name in COLOURS)
PYTHON
echo "as described"
