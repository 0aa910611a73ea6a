"""A scene of Gaussians that somebody has: seen, styled, and given back with other colours."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.lib.recfunctions import append_fields
from plyfile import PlyData, PlyElement

import anystyle
from anystyle.commands import stylize
from anystyle.errors import UserError
from anystyle.io.sheet import to_pil
from anystyle.methods.branch import Branch
from anystyle.methods.colors import covering_views, fit_colors
from anystyle.pipeline import saved
from anystyle.pipeline.encode import BYTES, BYTES_A_PIXEL, encode, require_splat
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.results import Restyler
from anystyle.pipeline.saved import read_saved
from anystyle.pipeline.stages import Stages
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.export_scene import export
from tests.support.known_scene import photographed_wall, rig, wall
from tests.support.resident import sampled_peak
from tests.support.worlds import painting

RENDERER = CpuRenderer(background=(0.0, 0.0, 0.0))
COLORS = ("f_dc", "f_rest")


def encoded_file(path, stylizer, views, options):
    return encode(saved.read_splat(path, stylizer, views, options, Stages()), stylizer, views, Stages())


def glossy(degree=1):
    """The wall with colours that depend on the direction."""
    scene = wall()
    generator = torch.Generator().manual_seed(1)
    higher = 0.1 * torch.randn(1, scene.means.shape[1], (degree + 1) ** 2 - 1, 3, generator=generator)
    return replace(scene, harmonics=torch.cat([scene.harmonics, higher], dim=2))


@pytest.fixture
def file(tmp_path):
    """As a trainer writes it: another property, an opacity of 0, quaternions of any norm."""
    path = tmp_path / "scene.ply"
    glossy().save(path)
    data = PlyData.read(path)["vertex"].data
    wider = append_fields(data, "label", np.arange(len(data)), "i4", usemask=False)
    wider["opacity"][3] = -200.0
    for index in range(4):
        wider[f"rot_{index}"] *= 1.7
    PlyData([PlyElement.describe(wider, "vertex")], comments=["mine"]).write(path)
    return path


def alone(gaussians):
    return StyledScene((("scene", gaussians),))


def transforms(folder, cameras):
    frames = [
        {"file_path": f"images/{view}.png", "transform_matrix": (pose @ np.diag([1, -1, -1, 1])).tolist()}
        for view, pose in enumerate(cameras.world_from_camera[0].double().numpy())
    ]
    height, width = cameras.size
    both = {"fl_x": 50.0, "fl_y": 50.0, "cx": width / 2, "cy": height / 2, "w": width, "h": height, "frames": frames}
    (folder / "transforms.json").write_text(json.dumps(both))


@pytest.mark.parametrize("keep", [False, True])
def test_the_command_gives_the_file_back_with_other_colours(file, tmp_path, keep):
    transforms(tmp_path, rig(5))
    style = tmp_path / "stripes.png"
    to_pil(painting().image[0]).save(style)
    words = ["video.frames=2", "views.short_side=40", "splat.cameras=3", f"method.keep_harmonics={keep}"]
    stylize.main([str(file), "--image", str(style), "--out", str(tmp_path / "out"), *words])
    before = PlyData.read(file)["vertex"].data
    after = PlyData.read(tmp_path / "out" / "scene.ply")["vertex"].data
    assert len(after) == len(before)
    dropped = [name for name in before.dtype.names if name not in after.dtype.names]
    assert dropped == ([] if keep else [f"f_rest_{index}" for index in range(9)])
    changed = [name for name in after.dtype.names if after[name].tobytes() != before[name].tobytes()]
    assert changed == ["f_dc_0", "f_dc_1", "f_dc_2"]
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["reconstruction"]["kind"] == "given" and report["reconstruction"]["cameras"] == "stored"
    assert report["inputs"] == ["0", "2", "4"] and report["method"] == {"kind": "branch", "networks": []}


def test_a_file_in_other_axes_is_seen_upright_and_comes_back_in_ours(tmp_path):
    """Rings of cameras look at z up and at OpenCV's axes alike once they are said, or stated by the file."""
    stylizer = anystyle.load()
    encoded = {}
    for up in ("opencv", "z"):
        export(glossy(), tmp_path / f"{up}.ply", "ply", up=up)
        options = SplatOptions(cameras=2, up=None if up == "z" else "-y")
        encoded[up] = encoded_file(tmp_path / f"{up}.ply", stylizer, ViewOptions(short_side=28), options)
    torch.testing.assert_close(encoded["z"].views.images, encoded["opencv"].views.images, rtol=0, atol=2e-3)
    torch.testing.assert_close(Restyler(encoded["z"], Branch()).unstyled.means, glossy().means, rtol=0, atol=1e-5)
    assert encoded["opencv"].splat is not None and encoded["z"].splat is None
    with pytest.raises(ValueError, match="choose one of None, opencv, x, -x, y, -y, z, -z"):
        SplatOptions(up="w")


def test_cameras_that_are_stored_see_what_they_saw(tmp_path):
    images, cameras, _ = photographed_wall(5)
    wall().save(tmp_path / "scene.ply")
    transforms(tmp_path, cameras)
    seen, sources, origin = saved.cameras_of(
        tmp_path / "scene.ply", alone(wall()), ViewOptions(short_side=40), SplatOptions(cameras=5), RENDERER, 8, 224
    )
    assert origin == "stored" and [source.name for source in sources] == list("01234") and seen.size == (40, 48)
    with torch.no_grad():
        renders = RENDERER(Gaussians.load(tmp_path / "scene.ply"), seen).color[0]
    assert (renders - images).abs().max() < 0.01


def test_cameras_around_a_scene_see_it_whole(tmp_path):
    scene = wall()
    far = torch.cat([scene.means, torch.tensor([[[500.0, 0, 0]]])], dim=1)  # one floater, nearly transparent
    parts = {name: torch.cat([value, value[:, :1]], dim=1) for name, value in vars(scene).items()}
    scene = replace(scene, **{**parts, "means": far})
    scene.opacities[0, -1] = 0.01
    seen, sources, origin = saved.cameras_of(
        tmp_path / "scene.ply", alone(scene), ViewOptions(), SplatOptions(cameras=6), RENDERER, 14, 112
    )
    assert origin == "chosen" and len(sources) == 6 and seen.size == (112, 112)
    with torch.no_grad():
        alpha = RENDERER(scene, seen).alpha[0]
    border = torch.cat([alpha[:, 0], alpha[:, -1], alpha[:, :, 0], alpha[:, :, -1]], dim=1)
    # The wall is 4 wide: seen from its edge it is a line, from everywhere it lies inside of the image.
    assert alpha.amax((1, 2)).min() > 0.9 and border.mean() < 0.2


@pytest.mark.parametrize("turned", [1.0, -1.0])
def test_cameras_around_a_scene_face_what_a_wall_hides(turned):
    """Half of a full ring would stand behind it, or beside it."""
    behind, front = wall(), torch.tensor([0.0, 0.0, 0.6])
    ornament = replace(behind, means=behind.means * 0.4 - front, scales=0.4 * behind.scales)
    detail = replace(behind, means=behind.means * 0.2 - 2 * front, scales=0.2 * behind.scales)
    scene = Gaussians.cat([behind, ornament, detail], dim=1)
    scene = replace(scene, means=scene.means * torch.tensor([turned, 1.0, turned]))
    eyes = saved.facing(scene, 12, 64, RENDERER).world_from_camera[0, :, :3, 3]
    assert 4 <= len(eyes) <= 12 and bool((turned * eyes[:, 2] < -0.5 * eyes[:, 0].abs()).all())
    ball = replace(behind, means=torch.nn.functional.normalize(torch.randn(1, 1089, 3), dim=2))
    eyes = saved.facing(ball, 12, 64, RENDERER).world_from_camera[0, :, :3, 3]
    assert len(eyes) == 12 and float(eyes[:, [0, 2]].mean(0).norm()) < 1 and len(set(eyes[:6, 1].round().tolist())) == 2


def test_harmonics_that_are_kept_are_taken_into_account():
    """A view-dependent scene is its own solution where they are kept."""
    scene, cameras = glossy(), rig(6)
    with torch.no_grad():
        renders = RENDERER(scene, cameras).color[0]
    kept = fit_colors(scene, cameras, renders, RENDERER, steps=30, damping=1e-4, keep=True)
    dropped = fit_colors(scene, cameras, renders, RENDERER, steps=30, damping=1e-4)
    assert torch.equal(kept.harmonics[:, :, 1:], scene.harmonics[:, :, 1:]) and dropped.harmonics.shape[2] == 1
    with torch.no_grad():
        errors = [(RENDERER(result, cameras).color[0] - renders).square().mean() for result in (kept, dropped)]
    assert errors[0] < 0.2 * errors[1]


def test_memory_is_told_and_refused_before(monkeypatch):
    device = torch.device("cpu")
    monkeypatch.setattr("anystyle.pipeline.encode.available", lambda device: 4 << 30)
    cameras = Cameras(torch.zeros(1, 24, 4, 4), torch.zeros(1, 24, 3, 3), (384, 384))
    assert require_splat(1_000_000, cameras, device) == "1,000,000 Gaussians from 24 views take about 1 GiB"
    with pytest.raises(ValueError, match=r"fewer Gaussians, or fewer views with splat\.cameras"):
        require_splat(5_000_000, cameras, device)


def test_what_it_takes_is_what_was_told():
    count, views = 30_000, 4
    generator = torch.Generator().manual_seed(0)
    scene = Gaussians(
        torch.randn(1, count, 3, generator=generator), torch.randn(1, count, 4, generator=generator),
        0.02 * torch.rand(1, count, 3, generator=generator), torch.rand(1, count, generator=generator),
        torch.zeros(1, count, 16, 3),
    )  # fmt: skip
    cameras = saved.around(scene, views, 64)
    targets = torch.rand(views, 3, 64, 64, generator=generator)
    fit_colors(scene, cameras, targets, RENDERER, steps=0)  # compiled before
    idle = sampled_peak(lambda: None)
    used = sampled_peak(lambda: fit_colors(scene, cameras, targets, RENDERER, steps=1)) - idle
    assert used < count * BYTES + views * 64**2 * BYTES_A_PIXEL


def test_results_are_restyled_at_the_size_they_were_made_at(tmp_path):
    """Of a folder, of its file, and of one of several styles; a scene of unknown origin has a size of ours."""
    (tmp_path / "photos").mkdir()
    for index, image in enumerate(photographed_wall(3)[0]):
        to_pil(image).resize((96, 80)).save(tmp_path / "photos" / f"{index}.png")
    made = tmp_path / "made"
    options = ["--out", str(made), "views.short_side=56", "poses=predicted", "video.frames=2"]
    stylize.main([str(tmp_path / "photos"), "--text", "red dots", "--text", "blue", *options])
    stylizer, given = anystyle.load(), SplatOptions(cameras=2)
    folder = next(path for path in made.iterdir() if (path / "scene.ply").is_file())
    for path in (made, folder, folder / "scene.ply"):
        assert min(encoded_file(path, stylizer, ViewOptions(), given).views.size) == 56
    alone = tmp_path / "elsewhere" / "deeper" / "scene.ply"
    alone.parent.mkdir(parents=True)
    alone.write_bytes((folder / "scene.ply").read_bytes())
    (alone.parent / "report.json").write_text('{"size": "of something else"}')
    assert encoded_file(alone, stylizer, ViewOptions(), given).views.size == (378, 378)
    assert encoded_file(alone, stylizer, ViewOptions(short_side=28), given).views.size == (28, 28)


def test_results_say_whether_cameras_are_those_of_photographs(tmp_path):
    """What was photographed from elsewhere than cameras that were chosen is not known, however often it is restyled."""
    wall().save(tmp_path / "scene.ply")
    short = ["--text", "red dots", "views.short_side=28", "splat.cameras=2", "video.frames=2"]
    stylize.main([str(tmp_path / "scene.ply"), *short, "--out", str(tmp_path / "chosen")])
    stylize.main([str(tmp_path / "chosen"), *short, "--out", str(tmp_path / "again")])
    assert not read_saved(tmp_path / "chosen").photographed and not read_saved(tmp_path / "again").photographed
    assert not read_saved(tmp_path / "chosen" / "scene.ply").photographed
    report = tmp_path / "chosen" / "report.json"
    report.write_text(report.read_text().replace('"cameras": "chosen"', '"cameras": "chosen around the scene"'))
    assert not read_saved(tmp_path / "chosen").photographed  # as 0.1 wrote it
    transforms(tmp_path, photographed_wall(3)[1])
    stylize.main([str(tmp_path / "scene.ply"), *short, "--out", str(tmp_path / "stored")])
    assert read_saved(tmp_path / "stored").photographed


def test_harmonics_that_are_dropped_are_told_once_and_pictures_are_made_where_they_are_asked_for(
    tmp_path, caplog, capsys
):
    glossy(degree=2).save(tmp_path / "scene.ply")
    pictures = {"renders", "video.mp4"}
    for keep, more in ((False, ()), (True, ("export.renders=true", "video.fps=36"))):
        caplog.clear()
        words = ["views.short_side=28", "splat.cameras=6", f"method.keep_harmonics={keep}", *more]
        out = ["--text", "red dots", "--text", "blue", "--out", str(tmp_path / f"{keep}")]
        stylize.main([str(tmp_path / "scene.ply"), *out, *words])
        told = [line for line in caplog.messages if "harmonics" in line]
        line = "harmonics of degree 1 to 2 of the given scene are dropped; method.keep_harmonics=true keeps them"
        assert told == ([] if keep else [line])
        made = {path.name for path in (tmp_path / f"{keep}" / "01-red-dots").iterdir()}
        assert "sheet.png" in made and pictures & made == (pictures if keep else set())
        assert ("sheet; export.renders=true adds renders and a film of 72 frames" in capsys.readouterr().err) != keep


def test_cameras_that_see_nothing_are_told_or_refused(tmp_path, caplog):
    """Of another scene, or in another frame; in between, the one that looks away is named."""
    cameras = rig(3)
    away = replace(cameras, world_from_camera=cameras.world_from_camera.clone())
    away.world_from_camera[0, 1, :3, :3] @= torch.diag(torch.tensor([-1.0, 1.0, -1.0]))
    wall().save(tmp_path / "scene.ply")
    transforms(tmp_path, away)
    stylizer, options = anystyle.load(), (ViewOptions(short_side=28), SplatOptions(cameras=3))
    encoded = encoded_file(tmp_path / "scene.ply", stylizer, *options)
    assert "1 of 3 cameras see less than 1% of the scene (1); splat.folder=FOLDER" in caplog.text
    far = replace(wall(), means=wall().means + 1000)
    assert fit_colors(far, encoded.cameras, encoded.views.images[0], RENDERER).harmonics.isfinite().all()
    assert len(covering_views(far, encoded.cameras, RENDERER, share=0.9, most=3)) == 1
    far.save(tmp_path / "scene.ply")
    with pytest.raises(UserError, match=r"none of the 3 cameras sees more than 1% .* splat\.folder=FOLDER"):
        encoded_file(tmp_path / "scene.ply", stylizer, *options)


def floor(normal):
    """Flat, level discs across an axis."""
    generator = torch.Generator().manual_seed(0)
    means, scales = torch.randn(1, 300, 3, generator=generator), torch.full((1, 300, 3), 0.05)
    means[..., normal] *= 0.05
    scales[..., normal] = 0.005
    return Gaussians(
        means, torch.eye(4)[:1].expand(1, 300, 4), scales, torch.full((1, 300), 0.9), torch.rand(1, 300, 1, 3)
    )


@pytest.mark.parametrize(("normal", "told"), [(1, "up is taken to be -y, and"), (2, "splat.up=z if renders lie")])
def test_cameras_that_are_chosen_are_told_with_what_is_taken_for_up(tmp_path, caplog, normal, told):
    """A floor across z is one of a scene whose z is up; what the file or its user says is not doubted."""
    scene, path = alone(floor(normal)), tmp_path / "scene.ply"
    for up, own, expected in ((None, "opencv", told), ("z", "z", ""), (None, "y", ""), ("opencv", "opencv", "")):
        caplog.clear()
        saved.cameras_of(path, scene, ViewOptions(), SplatOptions(cameras=2, up=up), RENDERER, 14, 56, own)
        assert "no cameras are in scene.ply or beside it: 2 are chosen around the scene" in caplog.text
        assert expected in caplog.text and ("splat.up" in caplog.text) == bool(expected)


@pytest.mark.parametrize(("axis", "sign", "up"), [(2, 1, "z"), (1, 1, "y"), (1, -1, None), (2, -1, None)])
def test_a_floor_with_a_scene_above_it_says_which_axis_is_up(tmp_path, caplog, axis, sign, up):
    """Chosen cameras stand upright on it; -y is OpenCV's, and across z with all on one side before it may be a wall."""
    ground, heights = floor(axis), sign * torch.linspace(0.1, 2.0, 300)[None, :, None]
    means = (ground.means * 0.3).index_copy(2, torch.tensor([axis]), heights)
    scene = Gaussians.cat([ground, replace(ground, means=means, scales=torch.full((1, 300, 3), 0.03))], dim=1)
    options = (ViewOptions(), SplatOptions(cameras=3), RENDERER, 14, 56)
    cameras = saved.cameras_of(tmp_path / "scene.ply", alone(scene), *options)[0]
    assert bool((-cameras.world_from_camera[0, :, axis, 1] > 0.5).all()) == (up is not None)
    assert (f"; {up} is taken to be up, for a floor lies across it" in caplog.text) == (up is not None)
