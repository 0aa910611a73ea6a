"""Fits that begin with a given scene."""

from dataclasses import replace
from math import pi

import pytest
import torch
from plyfile import PlyData

from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity, matrix_from_vector
from anystyle.pipeline.save import write_cameras
from anystyle.types import SourceImage, Views
from anystyle_captures.fit import Fit, fit_photographs, warm
from anystyle_captures.fit_loop import FitOptions
from anystyle_captures.start import read_start
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.pipeline.test_saved import transforms
from tests.support.known_scene import photographed_wall, wall

RENDERER, NAMES = CpuRenderer(background=(0.0, 0.0, 0.0)), tuple(f"wall_{view}" for view in range(9))
OPTIONS = FitOptions(num_steps=60, evaluate_every=20)
ELSEWHERE = Similarity(torch.tensor(2.5), matrix_from_vector(torch.tensor([0.3, pi / 2, -0.2])), torch.full((3,), 20.0))
"""The frame of another program."""


@pytest.fixture(scope="module")
def views():
    images, cameras, _ = photographed_wall(num_views=9)
    return Views(images[None], cameras, names=NAMES)


def fit(views, options=OPTIONS, **rest):
    given = views.images[0], views.cameras, RENDERER
    return fit_photographs(*given, num_gaussians=900, options=options, heldout=(4,), **rest)


def saved(folder, gaussians, cameras=None, names=NAMES):
    """A file of Gaussians, and cameras as results have them beside it."""
    gaussians.save(folder / "scene.ply")
    if cameras is not None:
        sources = [SourceImage.covering(name, cameras.size, cameras.size) for name in names]
        write_cameras(folder / "cameras.json", cameras, sources)
    return folder / "scene.ply"


def test_a_result_gives_what_all_steps_do_in_half_of_them(views, tmp_path):
    """No step sees the photograph held out, in either fit."""
    draft = fit(views, replace(OPTIONS, num_steps=100))
    start = read_start(saved(tmp_path, draft.gaussians), views)
    whole, half = fit(views), fit(views, warm(OPTIONS, half=True), start=start)
    assert (half.steps, len(start.footprints)) == (30, draft.gaussians.means.shape[1])
    assert half.heldout.psnr > max(whole.heldout.psnr, draft.heldout.psnr)


def test_a_scene_of_another_frame_is_aligned_by_the_cameras_of_the_same_photographs(views, tmp_path, caplog):
    there = replace(views.cameras, world_from_camera=ELSEWHERE.poses(views.cameras.world_from_camera))
    path = saved(tmp_path, ELSEWHERE.gaussians(wall()), there.select([6, 2, 4]), ("wall_6.jpg", "wall_2", "other"))
    start = read_start(path, views)
    torch.testing.assert_close(start.given.means, wall().means, rtol=0, atol=1e-3)
    torch.testing.assert_close(start.given.scales, wall().scales, rtol=0, atol=1e-5)
    assert "begins with the 1089 Gaussians" in caplog.text and "aligned by 2 cameras" in caplog.text
    nearest = (start.given.means[0, :, None] - views.cameras.world_from_camera[0, :, :3, 3]).norm(dim=-1).amin(1)
    torch.testing.assert_close(start.footprints, nearest / 50)
    with pytest.raises(UserError, match="of another scene or in another frame"):
        read_start(saved(tmp_path, ELSEWHERE.gaussians(wall()), there, [f"x{view}" for view in range(9)]), views)
    with pytest.raises(UserError, match="do not move as the photographs' cameras do"):
        read_start(saved(tmp_path, ELSEWHERE.gaussians(wall()), there, NAMES[::-1]), views)


def test_cameras_in_the_axes_of_a_file_are_turned_with_it(views, tmp_path):
    away = Similarity(torch.tensor(1.0), torch.eye(3), torch.tensor([0.0, 2, 5]))
    away.gaussians(wall()).save(tmp_path / "wall.ply")
    PlyData([*PlyData.read(tmp_path / "wall.ply")], comments=["Vertical Axis: z"]).write(tmp_path / "z.ply")
    transforms(tmp_path, replace(views.cameras, world_from_camera=away.poses(views.cameras.world_from_camera)))
    start = read_start(tmp_path / "z.ply", replace(views, names=tuple("012345678")))
    torch.testing.assert_close(start.given.means, wall().means, rtol=0, atol=1e-3)


@pytest.mark.parametrize("degree", (0, 1, 3))
def test_harmonics_get_the_degree_of_the_fit(views, tmp_path, degree):
    colors = torch.rand(1, 1089, 9, 3, generator=torch.Generator().manual_seed(0))
    start = read_start(saved(tmp_path, replace(wall(), harmonics=colors)), views)
    harmonics, count = start.gaussians(degree).harmonics, (degree + 1) ** 2
    torch.testing.assert_close(harmonics[:, :, :9], colors[:, :, :count])
    assert harmonics.shape[2] == count and not harmonics[:, :, 9:].any()


def test_a_file_that_is_no_scene_is_one_line(views, tmp_path):
    (tmp_path / "notes.txt").write_text("no scene")
    for name in ("notes.txt", "missing.ply"):
        with pytest.raises(UserError, match=name):
            Fit(start=str(tmp_path / name), keep=False)(views, None, RENDERER)
