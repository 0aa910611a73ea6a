"""The pictures of ``docs/styles.md``, written into ``docs/pictures``; run it with ``PYTHONPATH=tests``.

Three procedural scenes of the held-out split, the first by number; the first twelve paintings by name among those of
the test data, and the captions that they have there. Nothing is chosen after looking.
"""

import sys
from pathlib import Path

import torch
from PIL import Image

import anystyle
from anystyle.data.captions import read_captions
from anystyle.data.images import read_image
from anystyle.io.sheet import to_pil
from anystyle.types import Scene, StyleEmbedding
from real_data import ROOT

NUM_SCENES, NUM_STYLES, SIDE, GAP = 3, 12, 112, 4
OUT = Path(__file__).parents[2] / "docs" / "pictures"


@torch.no_grad()
def main() -> None:
    scenes = anystyle.catalog().find("scenes", "procedural").load()(split="heldout", size=SIDE)
    stylizer = anystyle.load("painter")
    captions = read_captions(ROOT / "styles" / "captions.jsonl")
    names = sorted(captions)[:NUM_STYLES]
    embeddings = {
        "texts": [stylizer.embed(text=captions[name]) for name in names],
        "paintings": [stylizer.embed(image=read_image(ROOT / "styles" / name)[None]) for name in names],
    }
    rows: dict[str, list[list[Image.Image]]] = {kind: [] for kind in embeddings}
    for index in range(NUM_SCENES):
        scene = stylizer.encode(scenes.read(index, range(4)))
        unstyled = first_view(stylizer, scene, None)
        for kind, styles in embeddings.items():
            rows[kind].append([unstyled, *(first_view(stylizer, scene, style) for style in styles)])
    for kind, cells in rows.items():
        grid(cells).save(OUT / f"styles_{kind}.jpg", quality=88)
    for name in names:
        match = stylizer.style_encoder.match_text(captions[name])
        sys.stdout.write(f"| {captions[name]} | {', '.join(match.unknown_words)} | {match.similarity:.2f} |\n")


def first_view(stylizer: anystyle.Stylizer, scene: Scene, style: StyleEmbedding | None) -> Image.Image:
    gaussians = stylizer.unstyled(scene) if style is None else stylizer.restyle(scene, style)
    return to_pil(stylizer.render(gaussians, scene.cameras).color[0, 0])


def grid(cells: list[list[Image.Image]]) -> Image.Image:
    step = SIDE + GAP
    sheet = Image.new("RGB", (step * len(cells[0]) - GAP, step * len(cells) - GAP), "white")
    for row, images in enumerate(cells):
        for column, image in enumerate(images):
            sheet.paste(image, (column * step, row * step))
    return sheet


if __name__ == "__main__":
    main()
