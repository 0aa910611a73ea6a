"""Frames that all photographs share are found, and none where there is none."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, ImageDraw

import anystyle
from anystyle.contracts import PosedViews
from anystyle.data.folder import cover, image_files
from anystyle.data.frames import Inner, shared_frame
from anystyle.examples import resolved
from anystyle.pipeline.options import ViewOptions
from anystyle.pipeline.read import _estimated
from anystyle.pipeline.stages import Stages
from anystyle.reconstructions import Feedforward
from anystyle.testing.toy.pose_estimator import ToyPoseEstimator
from anystyle.types import Original


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


@pytest.mark.parametrize("straighten", [None, lambda picture: picture.transpose(Image.Transpose.FLIP_LEFT_RIGHT)])
def test_a_view_within_a_frame_is_found_in_the_whole_photograph(street, straighten):
    """What is drawn on the whole photograph, such as a mask, is seen where the photograph without a frame shows it."""
    whole, inner = framed(street[0], 8, 40, 12, 20), Inner(8 / 420, 40 / 360, 1 - 12 / 420, 1 - 20 / 360)
    original = inner.original(Original("a", None, (360, 420), whole, Image.Exif(), whole.convert("L")))
    assert original.size == (300, 400) == original.picture.size[::-1]
    assert original.mask is not None and original.mask.size == (400, 300)
    assert original.picture.tobytes() == street[0].tobytes()
    straight = original.picture if straighten is None else straighten(original.picture)
    view, shown = cover("a", straight, (400, 300), (64, 96))
    found = inner.source(replace(shown, straightened=straighten), (360, 420))
    assert found.size == (360, 420) and found.box == (8, shown.box[1] + 40, 408, shown.box[3] + 40)
    error = np.asarray(found.of_view(whole), float) - np.asarray(view)
    assert np.abs(error).mean() < 2  # two kinds of resampling


@pytest.mark.parametrize("frame", ["cut", "keep"])
def test_a_frame_is_cut_off_unless_it_is_kept(street, frame, tmp_path, caplog):
    for number, picture in enumerate(street[:4]):
        framed(picture, 0, 60, 0, 0).save(tmp_path / f"{number}.png")
    options, backbone = ViewOptions(frame=frame, short_side=90), anystyle.load("painter").backbone
    posed = _estimated([tmp_path], backbone, options, Feedforward(), ToyPoseEstimator(), Stages(), {})
    (line,) = (message for message in caplog.messages if "same frame" in message)
    told = "it is cut off (views.frame=keep keeps it)" if frame == "cut" else "it becomes part of the scene"
    assert line.startswith("4 of 4 photographs have the same frame (top 16.") and told in line
    assert isinstance(posed, PosedViews)
    title = ((posed.views.images[0, :, :2, 0] - 236 / 255).abs() < 0.02).all(1).float().mean()
    assert title > 0.5 if frame == "keep" else title < 0.1
    assert (posed.sources[0].box[1] >= 58) == (frame == "cut") and posed.sources[0].size == (360, 400)
