"""Cameras that are not exact come back before a fit, and exact ones stay."""

import sys
from dataclasses import replace
from functools import partial
from math import radians

import pytest
import torch
from torch.nn.functional import normalize

from anystyle.errors import UserError
from anystyle.geometry.transforms import matrix_from_vector, similarity_of_cameras
from anystyle_captures.fit import fit_photographs
from anystyle_captures.fit_loop import FitOptions, InitialScene
from anystyle_captures.masks import Masks
from anystyle_captures.poses import adjusted, difference
from anystyle_captures.trials import try_cameras
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.cards import photographed

OPTIONS = FitOptions(num_steps=120, evaluate_every=40)
FOCAL, VIEWS = 200.0, 7


@pytest.fixture(scope="module")
def photographs():
    return photographed(VIEWS, focal=FOCAL)


def disturbed(cameras, degrees=1.0, share=0.02):
    """Each camera turned by so much, and moved by a share of the mean distance from their centre."""
    generator = torch.Generator().manual_seed(1)
    axes = normalize(torch.randn(2, cameras.world_from_camera.shape[1], 3, generator=generator), dim=-1)
    pose = cameras.world_from_camera.clone()
    radius = (pose[0, :, :3, 3] - pose[0, :, :3, 3].mean(0)).norm(dim=1).mean()
    pose[0, :, :3, :3] @= matrix_from_vector(axes[0] * radians(degrees))
    pose[0, :, :3, 3] += share * radius * axes[1]
    return replace(cameras, world_from_camera=pose)


def off(cameras, exact):
    """How far cameras are from the exact ones, in the frame that suits best."""
    between = similarity_of_cameras(cameras.world_from_camera[0].double(), exact.world_from_camera[0].double())
    return difference(exact, replace(cameras, world_from_camera=between.poses(cameras.world_from_camera.double())))


fit = partial(fit_photographs, renderer=CpuRenderer(), num_gaussians=900, options=OPTIONS, heldout=(3,), refine=True)


@pytest.fixture(scope="module")
def refined(photographs):
    return fit(photographs[0], disturbed(photographs[1]))


@pytest.mark.parametrize(("degrees", "share"), [(0.5, 0.01), (4.0, 0.08)])
def test_cameras_agree_with_features_in_the_frame_that_they_had(photographs, degrees, share):
    images, exact = photographs
    given = disturbed(exact, degrees, share)
    found = adjusted(images, given, None)
    turned, moved = off(found, exact)
    assert turned < 0.15 and moved < 0.01 and off(given, exact)[0] > 0.8 * degrees
    between = similarity_of_cameras(*(cameras.world_from_camera[0].double() for cameras in (found, given)))
    assert abs(between.scale - 1) < 1e-5 and between.translation.abs().max() < 1e-5
    assert (between.rotation - torch.eye(3)).abs().max() < 1e-5


def test_disturbed_cameras_give_what_exact_ones_do(photographs, refined):
    images, cameras = photographs
    lost, exact = (fit(images, given, refine=False).heldout.psnr for given in (disturbed(cameras), cameras))
    assert lost + 2 < exact and refined.heldout.psnr > lost + 0.8 * (exact - lost)


def test_exact_cameras_lose_nothing(photographs):
    images, cameras = photographs
    short = replace(OPTIONS, num_steps=5)
    expected, result = (fit(images, cameras, refine=refine, options=short) for refine in (False, True))
    # Features agree with those that were given: the fit is the one without refinement.
    assert torch.equal(result.gaussians.means, expected.gaussians.means)
    assert torch.equal(result.world_from_camera, cameras.world_from_camera[0])
    assert torch.equal(result.intrinsics, cameras.intrinsics[0])


def test_cameras_by_which_fewer_depths_agree_are_given_up(photographs):
    cameras, scene = photographs[1], InitialScene(None, confirmed=0.1)
    off = disturbed(cameras)

    def initial(seen):
        if seen is off:
            raise UserError("no depth agrees")
        return scene

    assert try_cameras(off, cameras, initial) == (cameras, scene)
    assert try_cameras(cameras, off, lambda seen: scene._replace(confirmed=float(seen is cameras)))[0] is cameras
    with pytest.raises(UserError):
        try_cameras(cameras, off, initial)


def test_focal_lengths_are_found_where_they_are_off(photographs):
    images, cameras = photographs
    zoomed = replace(cameras, intrinsics=cameras.intrinsics * (1 + 0.2 * torch.tensor([1.0, 1.0, 0.0]).diag()))
    poses, lenses = (adjusted(images, given, None).intrinsics[0] for given in (disturbed(cameras), zoomed))
    assert torch.equal(poses, cameras.intrinsics[0])
    torch.testing.assert_close(lenses[:, [0, 1], [0, 1]], torch.full((VIEWS, 2), FOCAL), rtol=0.015, atol=0)
    torch.testing.assert_close(lenses[:, :2, 2], cameras.intrinsics[0, :, :2, 2])


def test_cameras_stay_where_photographs_share_nothing_or_features_are_not_to_be_had(photographs, monkeypatch, caplog):
    images, cameras = photographs
    nothing = Masks(torch.ones_like(images[:, 0]), torch.zeros_like(images[:, 0], dtype=torch.bool))
    for given, masks in ((torch.full_like(images, 0.5), None), (images, nothing)):
        assert adjusted(given, disturbed(cameras), masks) is None
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    assert adjusted(images, disturbed(cameras), None) is None
    assert "they are not refined: cameras from photos need pycolmap" in caplog.text


def test_refined_cameras_are_the_same_in_any_order_and_after_a_break(photographs, refined, tmp_path):
    order, seen = [2, 6, 0, 3, 5, 1, 4], []  # the fourth is held out in both
    images, given = photographs[0][order], disturbed(photographs[1]).select(order)

    def stop(progress):
        seen.append(progress.line)
        if seen[-1].startswith("step 80"):
            raise InterruptedError

    with pytest.raises(InterruptedError):
        fit(images, given, state=tmp_path / "state", on_progress=stop)
    assert {line.split()[0] for line in seen} == {"features", "matches", "step"}
    resumed = fit(images, given, state=tmp_path / "state")
    assert torch.equal(refined.gaussians.means, resumed.gaussians.means)
    assert torch.equal(refined.world_from_camera[order], resumed.world_from_camera)
    assert refined.heldout == resumed.heldout
