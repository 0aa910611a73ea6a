"""Cameras beside a splat, as the trainers of this field leave them."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from plyfile import PlyData, PlyElement

from anystyle.commands import film, stylize
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity
from anystyle.pipeline.beside import cameras_beside, saved_cameras, with_stored_cameras
from anystyle.pipeline.export import turn
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.request import SavedScene, inputs_of
from anystyle.pipeline.saved import cameras_of, read_saved, read_unturned
from anystyle_formats.command_export import export, parser
from tests.pipeline.test_saved import RENDERER, transforms
from tests.support.known_scene import photographed_wall, wall

SHORT = ["views.short_side=28", "splat.cameras=2", "video.frames=2"]


def renders(path, up=None):
    options = SplatOptions(up=up)
    given = read_unturned(path, options)
    scene = with_stored_cameras(read_saved(path, options), path, own_up=given.up)
    return RENDERER(scene.styles[-1][1], scene.cameras).color[0]


def test_cameras_of_nerfstudio_are_moved_into_the_frame_of_its_export(tmp_path):
    """A point of the model is ``scale (R x + t)``; the PLY says that its z axis is up, and older ones say nothing."""
    images, cameras, _ = photographed_wall(3)
    rotation = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    moved = Similarity(torch.tensor(0.25), rotation, 0.25 * torch.tensor([-2.0, 0.5, -1]))
    moved.gaussians(wall()).save(tmp_path / "splat.ply")
    transforms(tmp_path, cameras)
    frame = np.column_stack([rotation.numpy(), [-2.0, 0.5, -1]])
    with torch.no_grad():
        assert (renders(tmp_path / "splat.ply") - images).abs().max() > 0.1
        (tmp_path / "dataparser_transforms.json").write_text(json.dumps({"transform": frame.tolist(), "scale": 0.25}))
        assert (renders(tmp_path / "splat.ply") - images).abs().max() < 0.01
        data = PlyData.read(tmp_path / "splat.ply")
        PlyData(list(data.elements), comments=["Vertical Axis: z"]).write(tmp_path / "newer.ply")
        assert read_unturned(tmp_path / "newer.ply").up == "z"
        assert (renders(tmp_path / "newer.ply") - images).abs().max() < 0.01
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps({"transform": frame[:2].tolist(), "scale": 1}))
    with pytest.raises(UserError, match=r"dataparser_transforms\.json"):
        cameras_beside(tmp_path / "splat.ply", None, read_saved(tmp_path / "splat.ply"), "z")


def test_cameras_in_the_axes_of_a_file_are_turned_with_it(tmp_path, caplog):
    """A trainer's cameras have the frame of its splat, whichever axis of it is up; others are in OpenCV's."""
    images, cameras, _ = photographed_wall(3)
    away = Similarity(torch.tensor(1.0), torch.eye(3), torch.tensor([0.0, 2, 5]))
    away.gaussians(wall()).save(tmp_path / "silent.ply")
    data = PlyData.read(tmp_path / "silent.ply")
    PlyData(list(data.elements), comments=["Vertical Axis: z"]).write(tmp_path / "splat.ply")
    alike = away.poses(cameras.world_from_camera)
    upright = turn("z", "opencv", alike).poses(alike)
    for poses, told in ((alike, "it turned with them"), (upright, "it taken to be in OpenCV's axes")):
        transforms(tmp_path, replace(cameras, world_from_camera=poses))
        with torch.no_grad():
            assert (renders(tmp_path / "splat.ply") - images).abs().max() < 0.01
        assert f"for z is up in their file, and the cameras beside {told}" in caplog.text


@pytest.fixture
def run(tmp_path):
    """A run's folder of the first trainer of 3DGS."""
    _, cameras, _ = photographed_wall(3)
    for number, gaussians in ((7000, wall().map(lambda tensor: tensor[:, :200])), (30000, wall())):
        path = tmp_path / "run" / "point_cloud" / f"iteration_{number}" / "point_cloud.ply"
        path.parent.mkdir(parents=True)
        gaussians.save(path)
    (height, width), (matrix, *_) = cameras.size, cameras.intrinsics[0].tolist()
    listed = [
        {
            "id": index, "img_name": f"IMG_{index}", "width": width, "height": height, "position": pose[:3, 3].tolist(),
            "rotation": pose[:3, :3].tolist(), "fy": matrix[1][1], "fx": matrix[0][0],
        }
        for index, pose in enumerate(cameras.world_from_camera[0].double())
    ]  # fmt: skip
    (tmp_path / "run" / "cameras.json").write_text(json.dumps(listed))
    return tmp_path / "run"


def test_a_run_of_3dgs_is_a_scene_with_its_cameras(run, tmp_path):
    images, _, _ = photographed_wall(3)
    largest = run / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    assert inputs_of(run) == SavedScene(largest)
    assert read_saved(run).styles[0][1].means.shape == wall().means.shape
    (run / "scene.ply").write_bytes(largest.read_bytes())
    with torch.no_grad():
        for path in (largest, run / "scene.ply"):
            assert (renders(path) - images).abs().max() < 0.01
    stylize.main([str(run), "--text", "red dots", "--out", str(tmp_path / "out"), *SHORT])
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["inputs"] == ["IMG_0", "IMG_2"] and report["reconstruction"]["cameras"] == "stored"
    made = tmp_path / "out" / "scene.ply"
    beside = cameras_beside(made, None, read_saved(made), "opencv")
    assert sorted(beside) == ["IMG_0", "IMG_2"]  # a result's file has the cameras of its folder
    film.main([str(run), "--out", str(tmp_path / "film.mp4"), "video.frames=2", "video.height=32"])
    assert (tmp_path / "film.mp4").stat().st_size
    export(parser().parse_args([str(run), "--out", str(tmp_path / "again.ply")]))
    assert len(PlyData.read(tmp_path / "again.ply")["vertex"].data) == wall().means.shape[1]


def test_cameras_of_several_sizes_are_all_used_at_the_commonest(run):
    """What an upright photograph shows stays whole, also where its scene is read, written and read again."""
    images, known, _ = photographed_wall(3)
    listed = json.loads((run / "cameras.json").read_text())
    listed[0] |= {name: listed[0][name] // 2 for name in ("height", "fx", "fy")} | {"width": 5}
    (run / "cameras.json").write_text(json.dumps(listed))
    path = run / "point_cloud" / "iteration_30000" / "point_cloud.ply"
    with torch.no_grad():
        assert (renders(path) - images).abs().max() < 0.01
    again = with_stored_cameras(read_saved(path), path)
    assert [camera.size for camera in saved_cameras(again).values()] == [(20, 5), (40, 48), (40, 48)]
    cameras, sources, _ = cameras_of(path, again, ViewOptions(), SplatOptions(), RENDERER, 2, 40)
    assert cameras.size == known.size and [source.name for source in sources] == ["IMG_0", "IMG_1", "IMG_2"]
    assert sources[0].inside == (19, 0, 29, 40)
    torch.testing.assert_close(cameras.intrinsics, known.intrinsics)


def test_a_damaged_list_of_cameras_is_one_line(run):
    listed = json.loads((run / "cameras.json").read_text())
    listed[1]["rotation"][0] = [2.0, 0.0, 0.0]
    (run / "cameras.json").write_text(json.dumps(listed))
    with pytest.raises(UserError, match=r"cameras.json: a pose has no rotation in it \(IMG_1\)"):
        renders(run / "point_cloud" / "iteration_7000" / "point_cloud.ply")


@pytest.mark.parametrize("name", ["ckpt_29999_rank0.pt", "step-000029999.ckpt"])
def test_a_checkpoint_of_a_trainer_names_what_to_type(tmp_path, name):
    (tmp_path / name).write_bytes(b"PK")
    for read in (inputs_of, read_saved):
        with pytest.raises(UserError, match=r"is a checkpoint.*--save_ply.*ns-export gaussian-splat"):
            read(tmp_path / name)
    with pytest.raises(UserError, match=rf"{name} is a checkpoint.*--save_ply"):
        inputs_of(tmp_path)  # a folder of such


def test_the_camera_in_a_file_of_sharp_is_its_view(tmp_path):
    """Elements behind the vertices hold the pose, the intrinsics and the size of the one photograph."""
    images, cameras, _ = photographed_wall(3)
    wall().save(tmp_path / "plain.ply")
    height, width = cameras.size
    values = {
        "extrinsic": cameras.world_from_camera[0, 1].inverse().numpy().ravel(),
        "intrinsic": cameras.intrinsics[0, 1].numpy().ravel(),
        "image_size": np.array([width, height], np.uint32),
    }
    more = [PlyElement.describe(each.view([(name, each.dtype)]), name) for name, each in values.items()]
    PlyData([PlyData.read(tmp_path / "plain.ply")["vertex"], *more]).write(tmp_path / "sharp.ply")
    scene = read_saved(tmp_path / "sharp.ply")
    assert scene.names == ("photograph",) and scene.cameras.size == cameras.size
    with torch.no_grad():
        assert (RENDERER(scene.styles[-1][1], scene.cameras).color[0, 0] - images[1]).abs().max() < 0.01
    film.main([str(tmp_path / "sharp.ply"), "--out", str(tmp_path / "film.mp4"), "video.frames=2", "video.height=32"])
