"""The pictures of the README: ``example:street`` in texts and paintings that come with the package.

``docs/pictures/street.jpg`` is one view as it was photographed, unstyled and in each style; ``street.webp`` beside it
is a flight through the cameras on which the styles change. Another folder may be given.
"""

import sys
from pathlib import Path

from PIL import Image

import anystyle
from anystyle.geometry.cameras import smooth_path
from anystyle.io.sheet import contact_sheet, to_pil

TEXTS = ["pink and mint watercolor", "charcoal drawing"]
PAINTINGS = ["starry_night", "wave", "scream", "water_lilies"]
OUT = Path(__file__).parents[2] / "docs" / "pictures"
VIEW, COLUMNS = 0, 4
FRAMES, WIDTH, MILLISECONDS, LARGEST = 20, 480, 80, 2_500_000
"""Of the flight: frames in each style, pixels, time of a frame, bytes of the file."""


def main(out: Path = OUT) -> None:
    styles = [*TEXTS, *(Path(f"example:{name}") for name in PAINTINGS)]
    results = anystyle.stylize("example:street", styles, views=anystyle.ViewOptions(short_side=384))
    encoded, unstyled = results.encoded, results.restyler.unstyled
    scenes = [("unstyled", unstyled), *((result.style.title, result.gaussians) for result in results)]
    camera, route = encoded.cameras.select([VIEW]), smooth_path(encoded.cameras, FRAMES * len(scenes))
    cells = [("photograph", to_pil(encoded.views.images[0, VIEW]))]
    cells += [(title, to_pil(next(encoded.render(scene, camera)))) for title, scene in scenes]
    rows = [cells[start : start + COLUMNS] for start in range(0, len(cells), COLUMNS)]
    strips = [contact_sheet([[cell for _, cell in row]], column_titles=[title for title, _ in row],
                            cell=cells[0][1].size) for row in rows]  # fmt: skip
    grid = Image.new("RGB", (strips[0].width, sum(strip.height for strip in strips)), "white")
    for index, strip in enumerate(strips):
        grid.paste(strip, (0, sum(above.height for above in strips[:index])))
    grid.save(out / "street.jpg", quality=88)
    frames: list[Image.Image] = []
    for index, (_, scene) in enumerate(scenes):
        for image in encoded.render(scene, route.select(slice(index * FRAMES, (index + 1) * FRAMES))):
            frame = to_pil(image)
            frames.append(frame.resize((WIDTH, round(WIDTH * frame.height / frame.width)), Image.Resampling.LANCZOS))
    for quality in (75, 60, 45, 30):  # the best that is small enough
        film = {"append_images": frames[1:], "duration": MILLISECONDS, "loop": 0, "quality": quality, "method": 4}
        frames[0].save(out / "street.webp", save_all=True, **film)
        if (out / "street.webp").stat().st_size <= LARGEST:
            break
    sys.stdout.write(f"{out / 'street.webp'}: {len(frames)} frames, {(out / 'street.webp').stat().st_size:,} bytes\n")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
