"""Strokes lie where they should, the way they should, whatever views they are seen from."""

import math
from dataclasses import replace

import pytest
import torch
from torch.nn.functional import interpolate

import anystyle
from anystyle.commands import stylize
from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.colors import colors_alone, pixels_shown
from anystyle.registry.build import build
from anystyle.types import Cameras, Gaussians, Style, Views
from anystyle_cpu_renderer.renderer import CpuRenderer
from anystyle_methods.brush import Brush
from anystyle_methods.flow import flow, structure_tensor
from tests.support.known_scene import wall as known_wall

SIDE = 96
COLOR = torch.tensor([1.0, 0.5, 0.2])[:, None, None]


def stripes(angle: float) -> torch.Tensor:
    """A wave whose crests run at an angle to the x axis."""
    y, x = torch.meshgrid(torch.arange(SIDE) + 0.5, torch.arange(SIDE) + 0.5, indexing="ij")
    across = -math.sin(angle) * x + math.cos(angle) * y
    return (0.5 + 0.4 * torch.sin(0.8 * across)).expand(1, 3, SIDE, SIDE)


@pytest.mark.parametrize("angle", [0.0, 0.5, 1.2, -0.9])
def test_a_picture_flows_along_its_stripes(angle):
    direction, clarity = flow(structure_tensor(stripes(angle), 1.0, 4.0))
    inner = direction[0, :, 16:-16, 16:-16]
    along = (inner[0] * math.cos(angle) + inner[1] * math.sin(angle)).abs()
    assert along.min() > 0.99 and clarity[0, 16:-16, 16:-16].min() > 0.9


@pytest.fixture(scope="module")
def wall():
    """A wall of Gaussians at depth 2, seen by two cameras that are beside each other, with slanted stripes on it."""
    generator = torch.Generator().manual_seed(0)
    x, y = torch.meshgrid(torch.linspace(-1.2, 1.2, 40), torch.linspace(-1.2, 1.2, 40), indexing="ij")
    means = torch.stack([x.flatten(), y.flatten(), torch.full((1600,), 2.0)], dim=1)
    gray = constant_from_rgb(torch.full((1600, 3), 0.5) + 0.05 * torch.randn(1600, 1, generator=generator))
    gaussians = Gaussians(
        means[None], torch.eye(4)[0].repeat(1, 1600, 1), torch.full((1, 1600, 3), 0.04), torch.full((1, 1600), 0.9),
        gray[None, :, None],
    )  # fmt: skip
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, 0, 3] = 0.2
    intrinsics = torch.tensor([[96.0, 0, 48], [0, 96.0, 48], [0, 0, 1]]).repeat(1, 2, 1, 1)
    cameras = Cameras(poses, intrinsics, (SIDE, SIDE))
    views = Views(stripes(0.6).expand(2, 3, SIDE, SIDE)[None], cameras, names=("a", "b"))
    return replace(colors_alone(views), gaussians=gaussians)


def test_pixels_shown_add_up_to_what_is_covered(wall):
    renderer = CpuRenderer()
    shown = pixels_shown(wall.gaussians, wall.cameras, renderer)
    alpha = renderer(wall.gaussians, wall.cameras).alpha[0].sum((1, 2))
    torch.testing.assert_close(shown.sum(1), alpha, rtol=1e-4, atol=1e-2)


@pytest.fixture(scope="module")
def result(wall):
    """The wall with strokes of the defaults."""
    return painted(wall)


def painted(wall, **options):
    stylizer = anystyle.load("painter")
    painting = stripes(-0.4) * COLOR
    return Brush(**options)(stylizer, wall, Style(image=painting), stylizer.embed(image=painting))


def test_strokes_lie_on_the_wall_along_its_stripes(wall, result):
    number = wall.gaussians.means.shape[1]
    strokes = result.map(lambda tensor: tensor[:, number:])
    assert torch.equal(result.means[:, :number], wall.gaussians.means)  # what was there stays where it is
    assert strokes.means.shape[1] > 200
    depth = strokes.means[0, :, 2]
    assert depth.min() > 1.9 and depth.max() < 2.0  # a little in front
    q = strokes.rotations[0]
    along = torch.stack(  # the first column of the rotation
        [1 - 2 * (q[:, 2] ** 2 + q[:, 3] ** 2), 2 * (q[:, 1] * q[:, 2] + q[:, 0] * q[:, 3])], dim=1
    )
    middle = strokes.means[0, :, :2].abs().amax(1) < 0.7
    assert (along @ torch.tensor([math.cos(0.6), math.sin(0.6)])).abs()[middle].median() > 0.9
    assert (strokes.scales[0, :, 0] > strokes.scales[0, :, 1]).all()  # longer than wide, and thin
    assert (strokes.scales[0, :, 2] < strokes.scales[0, :, 1]).all()
    rgb = rgb_from_constant(strokes.harmonics[0, :, 0])
    assert rgb.min() >= 0 and rgb.max() <= 1


def test_strokes_are_as_near_to_the_wall_under_a_long_lens(wall, result):
    number = wall.gaussians.means.shape[1]
    poses, intrinsics = wall.cameras.world_from_camera.clone(), wall.cameras.intrinsics.clone()
    poses[..., 2, 3] -= 14  # eight times as far away
    intrinsics[..., [0, 1], [0, 1]] *= 8
    views = replace(wall.views, cameras=Cameras(poses, intrinsics, wall.cameras.size))
    far = painted(replace(colors_alone(views), gaussians=wall.gaussians))
    heights = [2 - one.means[0, number:, 2] for one in (result, far)]
    assert 0 < heights[1].mean() < 1.2 * heights[0].mean()


def test_size_scales_strokes_and_the_seed_decides(wall, result):
    large, again = painted(wall, size=2.0, seed=1), painted(wall)
    number = wall.gaussians.means.shape[1]
    assert torch.equal(result.means, again.means)
    assert not torch.equal(result.means[:, number : number + 50], large.means[:, number : number + 50])
    assert large.means.shape[1] < result.means.shape[1]
    assert large.scales[0, number:, 0].min() > 1.5 * result.scales[0, number:, 0].min()


def test_strokes_have_the_size_of_the_painting_s_marks(wall):
    """A pattern twice as large has marks twice as long."""
    number, stylizer, found = wall.gaussians.means.shape[1], anystyle.load("painter"), []
    pattern = stripes(-0.4) * stripes(1.1)
    for painting in (pattern, interpolate(pattern, scale_factor=2, mode="bilinear")[..., :SIDE, :SIDE]):
        result = Brush()(stylizer, wall, Style(image=painting * COLOR), stylizer.embed(image=painting * COLOR))
        found.append(result.map(lambda tensor: tensor[:, number:]))
    fine, coarse = found
    assert coarse.scales[0, :, 0].median() > 1.5 * fine.scales[0, :, 0].median()
    assert coarse.means.shape[1] < fine.means.shape[1]


def test_strokes_end_where_the_photograph_changes(wall):
    """Half of the wall is dark: strokes stay on their half."""
    images = torch.full_like(wall.views.images, 0.2)
    images[..., :48, :] = 0.8  # above the middle, which is y = 0
    scene = replace(colors_alone(replace(wall.views, images=images)), gaussians=wall.gaussians)
    number = wall.gaussians.means.shape[1]
    strokes = painted(scene, size=3.0).map(lambda tensor: tensor[:, number:])
    q, half = strokes.rotations[0], strokes.scales[0, :, 0]
    reach = half * 2 * (q[:, 1] * q[:, 2] + q[:, 0] * q[:, 3])  # of the first axis along y
    y = strokes.means[0, :, 1]
    over = (reach.abs() - y.abs()).clamp_min(0)
    assert (over > 0.06).float().mean() < 0.02  # three pixels, that photographs are blurred by


def test_the_next_style_of_a_scene_is_as_of_a_new_brush(wall, result):
    brush, stylizer = Brush(), anystyle.load("painter")
    for painting in (stripes(1.0), stripes(-0.4) * COLOR):
        again = brush(stylizer, wall, Style(image=painting), stylizer.embed(image=painting))
    assert torch.equal(again.means, result.means) and torch.equal(again.harmonics, result.harmonics)


def test_scenes_of_the_single_pass_are_painted_on_too(wall):
    stylizer = anystyle.load("painter")
    scene = stylizer.encode(Views(wall.views.images[..., :56, :56]))
    result = Brush()(stylizer, scene, Style(text=("charcoal",)), stylizer.embed(text="charcoal"))
    assert result.means.shape[1] > stylizer.unstyled(scene).means.shape[1] + 20
    assert all(tensor.isfinite().all() for tensor in vars(result).values())


def test_options_are_checked():
    with pytest.raises(UserError, match=r"method\.size"):
        build(Method, {"_target_": "anystyle_methods.brush.Brush", "size": 0.0})


def test_several_styles_have_a_page_each_and_the_line_says_so(tmp_path, capsys):
    known_wall().marked(True).save(tmp_path / "wall.ply")
    words = ["--text", "blue", "--text", "red dots", "--export", "html", "--out", str(tmp_path / "out"), "method=brush"]
    stylize.main([str(tmp_path / "wall.ply"), *words, "views.short_side=56", "splat.cameras=2", "video.frames=2"])
    assert capsys.readouterr().out.strip().endswith("sheet.png; each style has a scene.html in its folder")
    pages = list((tmp_path / "out").glob("*/scene.html"))
    assert len(pages) == 2 and all('"antialiased": true' in page.read_text() for page in pages)
    replace(known_wall(), scales=known_wall().scales * 1e-3).marked(True).save(tmp_path / "thin.ply")
    with pytest.raises(SystemExit, match="2"):
        stylize.main([str(tmp_path / "thin.ply"), *words[:2], *words[6:], "splat.cameras=2", "views.short_side=28"])
    assert "anystyle: error: " in capsys.readouterr().err
