"""Frames that all photographs share are found, and none where there is none."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

from anystyle.data.folder import image_files
from anystyle.examples import resolved
from anystyle_captures.frames import shared_frame


@pytest.fixture(scope="module")
def street():
    return [
        Image.open(file).convert("RGB").resize((400, 300)) for file in image_files(resolved(Path("example:street")))
    ]


def framed(picture, left, top, right, bottom):
    window = Image.new("RGB", (left + picture.width + right, top + picture.height + bottom), (236, 236, 240))
    ImageDraw.Draw(window).text((8, 6), "File Edit View Help", fill=(20, 20, 20))
    window.paste(picture, (left, top))
    return window


@pytest.mark.parametrize("frame", [(0, 0, 0, 0), (8, 40, 8, 8), (0, 30, 0, 0), (0, 45, 0, 45), (60, 0, 60, 0)])
def test_the_frame_of_screenshots_is_found_through_compression(street, frame, tmp_path):
    pictures = []
    for number, picture in enumerate(street):
        framed(picture, *frame).save(tmp_path / f"{number}.jpg", quality=80)
        pictures.append(Image.open(tmp_path / f"{number}.jpg"))
    width, height = pictures[0].size
    found = shared_frame(pictures)
    sides = (("left", width), ("top", height), ("right", width), ("bottom", height))
    errors = [round(found.get(side, 0) * size) - given for (side, size), given in zip(sides, frame, strict=True)]
    assert np.abs(errors).max() <= 8  # a block of JPEG
    assert len(found) == np.count_nonzero(frame)


def test_a_backdrop_and_a_white_sky_are_no_frame(street):
    generator = np.random.default_rng(0)
    turning = []
    for picture in street:
        pixels = np.asarray(picture).copy()
        height, width = pixels.shape[:2]
        y, x = np.mgrid[:height, :width]
        away = np.hypot(x - width / 2 - generator.integers(-9, 9), y - height / 2)
        turning.append(Image.fromarray(np.where((away < 110)[..., None], pixels, 0).astype(np.uint8)))
    assert shared_frame(turning) == {}
    assert shared_frame(street[:2]) == {}
