"""Cameras that were known before, matched with photographs."""

import json

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.folder import read_views
from anystyle.pipeline.cameras import from_files, from_views
from anystyle.types import Cameras
from tests.support.refusals import raises_line


@pytest.fixture
def capture(tmp_path):
    """Four photographs, three of them with cameras."""
    (tmp_path / "images").mkdir()
    frames = []
    for number in range(4):
        Image.new("RGB", (64, 48), (60 * number, 90, 30)).save(tmp_path / "images" / f"{number}.png")
        pose = np.eye(4)
        pose[:3, 3] = [0.3 * number, 0.05 * number**2, 0.0]
        frames.append({"file_path": f"images/{number}.png", "transform_matrix": pose.tolist()})
    content = {"w": 640, "h": 480, "fl_x": 500, "fl_y": 500, "cx": 320, "cy": 240, "frames": frames[:3]}
    (tmp_path / "transforms.json").write_text(json.dumps(content))
    return tmp_path


def sources(capture, count):
    names = [capture / "images" / f"{number}.png" for number in range(count)]
    return read_views(names, short_side=24, multiple=8, max_views=8)


def test_cameras_above_the_photographs_are_matched_and_scaled(capture):
    known = from_files(*sources(capture, 2))[2]
    assert known.indices == (0, 1) and known.names == ("0", "1", "2") and known.targets.intrinsics.shape[1] == 3
    torch.testing.assert_close(known.views.intrinsics[0, 0, 0, 0], torch.tensor(500 * (known.views.size[0] / 480)))


def test_targets_are_placed_among_predicted_cameras(capture):
    known = from_files(*sources(capture, 3))[2]
    angle = 0.4
    turn = torch.eye(4)
    turn[:2, :2] = torch.tensor([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    pose = known.targets.world_from_camera.clone()
    pose[..., :3, 3] *= 2.5
    predicted = Cameras(turn @ pose, known.targets.intrinsics, known.targets.size)
    targets, similarity = known.targets_in_scene(predicted)
    torch.testing.assert_close(targets.world_from_camera, predicted.world_from_camera, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(similarity.scale, torch.tensor(2.5))


@pytest.mark.parametrize(
    ("name", "content", "told"),
    [
        ("transforms.json", b"[" * 10_000, "is nested deeper than"),
        ("transforms.json", b'{"w": 48, "h": 36, "fl_x": 0, "frames": []}', "at 'fl_x'"),
        ("poses_bounds.npy", b"\x93NUMPY\x01\x00v\x00{'shape': (9999999999, 17)}", "is not a valid array of poses"),
    ],
)
def test_damaged_files_are_refused(capture, name, content, told):
    (capture / "transforms.json").unlink()
    (capture / name).write_bytes(content)
    with raises_line(ValueError, match=told, naming=name):
        from_files(*sources(capture, 2))


def test_poses_that_do_not_match_are_refused(capture, tmp_path):
    assert from_files(*sources(capture, 4))[2].indices == (0, 1, 2)
    content = json.loads((capture / "transforms.json").read_text())
    (capture / "transforms.json").write_text(json.dumps(content | {"w": 480, "h": 480}))
    with pytest.raises(ValueError, match="for an image of 480x480"):
        from_files(*sources(capture, 2))
    (capture / "transforms.json").unlink()
    with pytest.raises(ValueError, match="no cameras are stored beside"):
        from_files(*sources(capture, 2))
    with pytest.raises(ValueError, match="knows no cameras"):
        from_views(None, ["a"])
