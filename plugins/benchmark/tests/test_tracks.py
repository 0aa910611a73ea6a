"""The bundled tracks, and how files are named in one."""

from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from anystyle.correspondences.rendered_depth import RenderedDepth
from anystyle.data.images import image_size, open_image, to_tensor
from anystyle.errors import UserError
from anystyle.geometry.warp import sample_at
from anystyle.io.arrays import read_arrays
from anystyle.types import Frames
from anystyle_benchmark.judge import DEPTH
from anystyle_benchmark.track import TRACKS, Inputs
from tests.support.benchmark_world import write_track


@pytest.mark.parametrize("name", ("open", "smoke", "ablation", "consistency"))
def test_a_shipped_track_is_whole_and_says_who_may_pass_it_on(name: str) -> None:
    inputs = Inputs(name)
    assert inputs.hashes == inputs.track.sha256
    for entry in (*inputs.track.scenes, *(style for style in inputs.track.styles if style.image)):
        assert entry.licence and entry.source and entry.title
    for scene in inputs.track.scenes:
        assert scene.licence == "Apache-2.0" or (inputs.path(scene.photographs) / "LICENCE.txt").is_file()
        depths = read_arrays(inputs.path(str(scene.geometry)) / DEPTH, scene.views, what="depth").values()
        assert all((depth > 0).mean() > 0.1 and depth.min() >= 0 for depth in depths)
        with np.load(inputs.path(str(scene.geometry)) / "cameras.npz") as cameras:
            assert set(scene.views) <= set(cameras["frames"])
            assert {depth.shape for depth in depths} == {tuple(cameras["size"])}


@pytest.mark.parametrize("name", ["open", "ablation"])
def test_photographs_moved_by_a_tracks_depth_agree(name: str) -> None:
    inputs = Inputs(name)
    for scene in inputs.track.scenes:
        folder, (height, width) = inputs.path(str(scene.geometry)), inputs.size(scene)
        files = [inputs.photographs(scene)[view] for view in scene.views]
        pictures = [ImageOps.fit(open_image(file), (width, height), Image.Resampling.LANCZOS) for file in files]
        images = torch.stack([to_tensor(picture) for picture in pictures])
        maps = read_arrays(folder / DEPTH, scene.views, what="depth")
        depth = torch.tensor(np.stack([maps[view] for view in scene.views])).float()
        with np.load(folder / "cameras.npz") as stored:
            poses, lenses = (torch.tensor(stored[key]) for key in ("world_from_camera", "intrinsics"))
        there = Frames(images, depth, poses, lenses)
        for frames in (there, there.map(lambda tensor: tensor.flip(0))):
            source, target = frames.map(lambda tensor: tensor[:-1]), frames.map(lambda tensor: tensor[1:])
            flow = RenderedDepth()(source, target)
            assert source.depth is not None and not flow.visible[source.depth == 0].any()
            warped, still = (
                (seen - source.images).square().mean(1)[flow.visible].mean().sqrt()
                for seen in (sample_at(target.images, flow.displacement), target.images)
            )
            assert warped < 0.6 * still, scene.name


def test_the_open_track_has_paintings_and_texts_of_the_sizes_it_promises() -> None:
    inputs = Inputs("open")
    assert [style.guide for style in inputs.track.styles] == ["image"] * 12 + ["text"] * 12
    assert sum(path.stat().st_size for _, path in inputs.files() if path.is_relative_to(TRACKS)) < 8 << 20
    assert all(min(image_size(inputs.path(str(style.image)))) > 300 for style in inputs.track.styles if style.image)


def test_a_path_is_beside_the_track_or_an_example(tmp_path: Path) -> None:
    inputs = Inputs("open", tmp_path)
    assert inputs.path("photographs/street") == tmp_path / "photographs" / "street"
    assert inputs.path("example:wave").name == "wave.jpg"


def test_the_papers_track_says_what_its_root_lacks(tmp_path: Path) -> None:
    inputs = Inputs("tnt", tmp_path)
    assert len(inputs.track.scenes) == 4 and len(inputs.track.styles) == 50 and not inputs.track.sha256
    with pytest.raises(UserError, match="Train lacks the photograph 0"):
        _ = inputs.hashes


def test_inputs_that_are_not_those_of_a_locked_track_are_named(tmp_path: Path) -> None:
    track = write_track(tmp_path)
    hashes = "".join(f'"{name}" = "{value}"\n' for name, value in Inputs(str(track)).hashes.items())
    track.write_text(f"{track.read_text()}\n[sha256]\n{hashes}")
    assert Inputs(str(track)).hashes == Inputs(str(track)).track.sha256
    (tmp_path / "styles" / "image0.png").write_bytes(b"another")
    with pytest.raises(UserError, match=r"styles/image0\.png is not the file"):
        _ = Inputs(str(track)).hashes


@pytest.mark.parametrize(
    ("line", "other", "message"),
    [
        ('name = "scene1"', 'name = "scene0"', "two scenes are named scene0"),
        ('name = "image1"', 'name = "text0"', "two styles are named text0"),
        ('"color_match"', '"colour_match"', "no metric is named 'colour_match'. Did you mean 'color_match'"),
        ('image = ["color', 'images = ["color', "is not a valid track"),
        ('"styles/image0.png"', '"styles/none.png"', r"lacks .*none\.png"),
        ('"geometry/scene0"', '"geometry/none"', "none with the depth and the cameras of scene0"),
    ],
)
def test_slips_in_a_track_are_one_line(tmp_path: Path, line: str, other: str, message: str) -> None:
    track = write_track(tmp_path)
    assert Inputs(str(track)).hashes
    track.write_text(track.read_text().replace(line, other))
    with pytest.raises(UserError, match=message):
        _ = Inputs(str(track)).hashes
