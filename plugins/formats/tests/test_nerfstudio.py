"""Checkpoints, runs and camera paths: closed forms, round trips, and readers of transforms.json that are not ours."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
import yaml
from PIL import Image
from plyfile import PlyData
from scipy.spatial.transform import Rotation

from anystyle.data.poses import stored_cameras
from anystyle.errors import UserError
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.pipeline.export import export_styles, in_axes
from anystyle.pipeline.saved import read_saved, read_unturned
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.inputs import cameras, gaussians
from anystyle.types import StyledScene
from anystyle_formats.nerfstudio.camera_path import read_camera_path
from anystyle_formats.nerfstudio.checkpoint import state_of
from anystyle_formats.nerfstudio.command import Nerfstudio, placed

APPLIED = np.array([[0, 1, 0, 0.5], [1, 0, 0, -2], [0, 0, -1, 1.0], [0, 0, 0, 1]])
"""As ns-process-data turns COLMAP's poses, with a translation."""
MOVED = np.array([0.3, -2.0, 1.0])
SCALE, APPLIED_SCALE = 0.19, 1.5


@pytest.fixture
def scene():
    return StyledScene((("red", gaussians(1, 60)),), cameras(1, 3, (24, 32)), ("a", "b", "c"))


def save(path, state, **further):
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save({"step": 10, "pipeline": state, "optimizers": {}, **further}, path)
    return path


def write_transforms(folder, seen, **further):
    """Poses as nerfstudio reads them: the camera looks along its -z, and its y points up."""
    poses = seen.world_from_camera[0].double().numpy() @ np.diag([1, -1, -1, 1])
    frames = [
        {"file_path": f"images/{index}.png", "transform_matrix": pose.tolist()} for index, pose in enumerate(poses)
    ]
    ((fx, _, cx), (_, fy, cy), _), (height, width) = seen.intrinsics[0, 0].tolist(), seen.size
    shared = {"w": width, "h": height, "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy}
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "transforms.json").write_text(json.dumps({**shared, **further, "frames": frames}))


def test_a_trained_run_is_read_where_its_cameras_are(tmp_path, monkeypatch, scene):
    """The closed form of what training and ns-process-data do to points is undone; renders agree with the scene's."""
    saved = in_axes("z", scene)  # in coordinates of transforms.json
    write_transforms(
        tmp_path / "photos", saved.cameras, applied_transform=APPLIED[:3].tolist(), applied_scale=APPLIED_SCALE
    )
    run = tmp_path / "outputs" / "photos" / "splatfacto" / "now"
    rotation = Rotation.from_euler("z", 30, degrees=True).as_matrix()  # z stays up
    model_from_saved = np.block([[rotation, (rotation @ MOVED)[:, None]], [np.zeros(3), 1]])
    given = saved.styles[0][1]
    means = SCALE * (given.means[0].numpy() @ rotation.T + rotation @ MOVED)
    quats = (Rotation.from_matrix(rotation) * Rotation.from_quat(given.rotations[0].roll(-1, -1).numpy())).as_quat()
    state = state_of(replace(given, harmonics=given.harmonics[:, :, :1])) | {
        "_model.gauss_params.means": torch.from_numpy(means).float(),
        "_model.gauss_params.quats": torch.from_numpy(quats).float().roll(1, -1),
        "_model.gauss_params.scales": (given.scales[0] * SCALE).log(),
        "_model.lpips.net": torch.zeros(3),
    }
    schedulers = {"means": {"_last_lr": [np.float64(1e-4)]}}
    path = save(run / "nerfstudio_models" / "step-000000010.ckpt", state, schedulers=schedulers)
    stored = {"transform": (model_from_saved @ APPLIED)[:3].tolist(), "scale": SCALE * APPLIED_SCALE}
    (run / "dataparser_transforms.json").write_text(json.dumps(stored))
    (run / "config.yml").write_text(
        "!!python/object:nerfstudio.engine.trainer.TrainerConfig\n"
        "_target: !!python/name:nerfstudio.engine.trainer.Trainer ''\n"
        "data: !!python/object/apply:pathlib.PosixPath [photos]\n"
        "pipeline: !!python/object:nerfstudio.x.Config\n"
        "  datamanager: !!python/object:nerfstudio.y.Config {data: null}\n"
    )
    monkeypatch.chdir(tmp_path / "outputs")
    read = read_unturned(path, None)
    assert read.up == "z" and read.names == ("0.png", "1.png", "2.png")
    torch.testing.assert_close(read.styles[0][1].means, given.means, atol=1e-5, rtol=0)
    torch.testing.assert_close(read.styles[0][1].scales, given.scales)
    torch.testing.assert_close(read.cameras.world_from_camera, saved.cameras.world_from_camera, atol=1e-5, rtol=0)
    flat = replace(scene.styles[0][1], harmonics=scene.styles[0][1].harmonics[:, :, :1])
    expected = TorchRenderer()(flat, scene.cameras).color
    turned = in_axes("opencv", read)
    torch.testing.assert_close(TorchRenderer()(turned.styles[0][1], turned.cameras).color, expected, atol=1e-3, rtol=0)

    (tmp_path / "photos" / "transforms.json").unlink()
    whole = np.concatenate([means / (SCALE * APPLIED_SCALE), np.ones((60, 1))], 1)
    original = whole @ np.linalg.inv(model_from_saved @ APPLIED).T
    back = read_unturned(path, None).styles[0][1].means[0].numpy()
    np.testing.assert_allclose(back, original[:, :3], atol=1e-5)


def test_export_is_a_data_folder_and_a_run(tmp_path, scene, capsys):
    """What is written is read back to the bits that float32 keeps, and images show the scene from their cameras."""
    export_styles(scene, tmp_path / "red.ply", "ply")
    write_transforms(tmp_path, scene.cameras)
    Nerfstudio()(["export", str(tmp_path / "red.ply"), "--out", str(tmp_path / "ns"), "--side", "24", "renderer=torch"])
    assert "ns-viewer --load-config" in capsys.readouterr().out
    run = tmp_path / "ns" / "red" / "splatfacto" / "anystyle"
    data = tmp_path / "ns" / "red" / "data"
    checkpoint = run / "nerfstudio_models" / "step-000029999.ckpt"
    assert checkpoint.stat().st_size < 60 * 23 * 4 + 4000, "more than its parameters is in it"
    read = read_saved(checkpoint)
    given = scene.styles[0][1]
    for name in ("means", "scales", "opacities", "harmonics"):
        torch.testing.assert_close(getattr(read.styles[0][1], name), getattr(given, name), atol=2e-5, rtol=1e-4)
    torch.testing.assert_close(read.cameras.world_from_camera, scene.cameras.world_from_camera, atol=1e-5, rtol=0)

    content = json.loads((data / "transforms.json").read_text())
    assert content["camera_model"] == "PINHOLE" and content["ply_file_path"] == "sparse_pc.ply"
    for index, frame in enumerate(content["frames"]):  # OpenGL: a point ahead of the camera has negative z
        pose = np.array(frame["transform_matrix"])
        world = in_axes("z", scene).styles[0][1].means[0].numpy()
        local = (world - pose[:3, 3]) @ pose[:3, :3]
        x = frame["fl_x"] * local[:, 0] / -local[:, 2] + frame["cx"]
        y = frame["fl_y"] * -local[:, 1] / -local[:, 2] + frame["cy"]
        camera = scene.cameras.camera_from_world[0, index].double()
        ours = given.means[0].double() @ camera[:3, :3].T + camera[:3, 3]
        pixels = ours @ scene.cameras.intrinsics[0, index].double().T
        np.testing.assert_allclose(np.stack([x, y], 1), (pixels[:, :2] / pixels[:, 2:]).numpy(), atol=1e-2)
        image = np.array(Image.open(data / frame["file_path"])) / 255
        expected = TorchRenderer()(given, scene.cameras.select([index])).color[0, 0].movedim(0, -1).clamp(0, 1)
        np.testing.assert_allclose(image, expected.numpy(), atol=1 / 254 + 1e-3)
    points = PlyData.read(data / "sparse_pc.ply")["vertex"]
    best = int(given.opacities[0].argmax())
    assert points["y"][0] == pytest.approx(float(given.means[0, best, 2]))
    color = rgb_from_constant(given.harmonics[0, best, 0]).clamp(0, 1) * 255
    assert abs(float(points["red"][0]) - float(color[0])) <= 0.51
    assert len(stored_cameras(data)) == 3

    text = (run / "config.yml").read_text()
    tagged = [node.tag for node in yaml.compose(text).value[0]]
    assert "Trainer" in tagged[1] and str((tmp_path / "ns" / "red" / "data").absolute()) in text


def test_colours_without_harmonics_are_sigmoids(tmp_path):
    state = {f"_model.{name}": torch.zeros(2, 3) for name in ("means", "scales")}
    state |= {"_model.quats": torch.ones(2, 4), "_model.opacities": torch.zeros(2, 1)}
    state["_model.features_dc"] = torch.tensor([[0.0, 2.0, -2.0], [torch.nan, 0.0, 0.0]])
    state["_model.features_rest"] = torch.zeros(2, 0, 3)
    read = read_unturned(save(tmp_path / "old.ckpt", state), None)
    assert read.up == "z" and read.styles[0][1].means.shape[1] == 1  # the other one is not finite
    color = rgb_from_constant(read.styles[0][1].harmonics[0, 0, 0])
    torch.testing.assert_close(color, torch.tensor([0.0, 2.0, -2.0]).sigmoid())


class Foreign:
    pass


def test_untrusted_checkpoints_end_in_a_line(tmp_path, scene):
    state = state_of(scene.styles[0][1])
    cases = {
        "no Gaussians of splatfacto": save(tmp_path / "a.ckpt", {"_model.field.x": torch.zeros(3)}),
        "holds code or objects": save(tmp_path / "b.ckpt", state, extra=Foreign()),
        "quats of shape": save(tmp_path / "c.ckpt", state | {"_model.gauss_params.quats": torch.zeros(60, 3)}),
        "no `pipeline`": tmp_path / "d.ckpt",
    }
    torch.save([1], tmp_path / "d.ckpt")
    for message, path in cases.items():
        with pytest.raises(UserError, match=message):
            read_unturned(path, None)
    good = save(tmp_path / "run" / "e.ckpt", state)
    stretched = {"transform": [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]], "scale": 1}
    (good.parent / "dataparser_transforms.json").write_text(json.dumps(stretched))
    with pytest.raises(UserError, match="not hold a rotation"):
        read_unturned(good, None)


def path_file(folder: Path, poses, **changes) -> Path:
    frames = [{"camera_to_world": np.asarray(pose).flatten().tolist(), "fov": 60.0, "aspect": 1.5} for pose in poses]
    content = {"keyframes": [], "camera_type": "perspective", "fps": 10, "seconds": len(frames) / 10}
    content |= {"render_height": 480, "render_width": 720, "camera_path": frames}
    file = folder / "path.json"
    file.write_text(json.dumps(content | changes))
    return file


def test_camera_paths(tmp_path, scene):
    """A camera at x=2 that looks along world y, z up: its OpenGL axes are x, z and -y."""
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]), [2, 0, 0]
    flight = read_camera_path(path_file(tmp_path, [pose, pose, pose]))
    assert flight.times.tolist() == pytest.approx([0, 0.1, 0.2]) and flight.cameras.size == (480, 720)
    seen = flight.cameras.camera_from_world[0, 0] @ torch.tensor([2.0, 5.0, 1.0, 1.0])
    torch.testing.assert_close(seen[:3], torch.tensor([0.0, -1.0, 5.0]), atol=1e-6, rtol=0)  # up is -y, ahead is z
    assert float(flight.cameras.intrinsics[0, 0, 1, 1]) == pytest.approx(240 / np.tan(np.pi / 6))
    assert flight.cameras.intrinsics[0, 0, :2, 2].tolist() == [360, 240]

    upright = placed(flight, None)  # of a run that export wrote
    ahead = upright.cameras.camera_from_world[0, 0] @ torch.tensor([2.0, -1.0, 5.0, 1.0])
    torch.testing.assert_close(ahead[:3], torch.tensor([0.0, -1.0, 5.0]), atol=1e-6, rtol=0)

    moved = np.array([[1, 0, 0, 1.0], [0, 1, 0, 0], [0, 0, 1, 0]])
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps({"transform": moved.tolist(), "scale": 0.5}))
    origin = placed(flight, tmp_path).cameras.world_from_camera[0, 0, :3, 3]
    torch.testing.assert_close(origin, torch.tensor([2 / 0.5 - 1, 0.0, 0.0]))

    out = tmp_path / "keyframes.json"
    Nerfstudio()(["path", str(tmp_path / "path.json"), "--out", str(out)])
    keys = json.loads(out.read_text())["keyframes"]
    assert [key["time"] for key in keys] == pytest.approx([0, 0.1, 0.2])
    assert keys[0]["fov"] == pytest.approx(60, abs=1e-3)
    np.testing.assert_allclose(keys[0]["world_from_camera"], upright.cameras.world_from_camera[0, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"camera_type": "equirectangular"}, "type perspective"),
        ({"camera_path": []}, "no frames"),
        ({"camera_path": [{"camera_to_world": [2.0] * 16, "fov": 60}]}, "not a rotation"),
        ({"camera_path": [{"camera_to_world": [0.0] * 15, "fov": 60}]}, "path of nerfstudio"),
    ],
)
def test_broken_paths_end_in_a_line(tmp_path, changes, message):
    with pytest.raises(UserError, match=message):
        read_camera_path(path_file(tmp_path, [np.eye(4)], **changes))
