"""Cameras that are not exact come back in a fit, and exact ones stay."""

from dataclasses import replace
from math import radians

import pytest
import torch
from torch.nn.functional import normalize

from anystyle.errors import UserError
from anystyle.geometry.transforms import matrix_from_vector, similarity_of_cameras
from anystyle_captures.fit import fit_photographs
from anystyle_captures.fit_loop import FitOptions
from anystyle_captures.poses import RefinedCameras
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.known_scene import rig, wall

OPTIONS = FitOptions(num_steps=160, evaluate_every=40, refine="poses")
RENDERER = CpuRenderer(background=(0.0, 0.0, 0.0))
HELDOUT = 4


@pytest.fixture(scope="module")
def photographs():
    cameras = rig(9).resized((80, 96))
    with torch.no_grad():
        return RENDERER(wall(), cameras).color[0], cameras


def disturbed(cameras, degrees=1.0, share=0.03):
    """Each camera turned by so much, and moved by a share of the distance to the wall."""
    generator = torch.Generator().manual_seed(1)
    axes = normalize(torch.randn(2, cameras.world_from_camera.shape[1], 3, generator=generator), dim=-1)
    pose = cameras.world_from_camera.clone()
    pose[0, :, :3, :3] @= matrix_from_vector(axes[0] * radians(degrees))
    pose[0, :, :3, 3] += share * axes[1]
    return replace(cameras, world_from_camera=pose)


def fit(images, cameras, options=OPTIONS, **rest):
    return fit_photographs(images, cameras, RENDERER, num_gaussians=900, options=options, heldout=(HELDOUT,), **rest)


@pytest.fixture(scope="module")
def refined(photographs):
    images, cameras = photographs
    return fit(images, disturbed(cameras))


@pytest.fixture(scope="module")
def exact(photographs):
    return fit(*photographs, replace(OPTIONS, refine="none"))


def test_disturbed_cameras_give_what_exact_ones_do(photographs, refined, exact):
    """At least 0.8 of the dB that they cost, with the view held out aligned; its own camera stays off as it is."""
    images, cameras = photographs
    plain = fit(images, disturbed(cameras), replace(OPTIONS, refine="none"))
    # The scene of disturbed cameras, seen from where it looks most like the photograph.
    motions = RefinedCameras(disturbed(cameras), unit=3.0)
    photograph = images[HELDOUT, None]
    with torch.no_grad():
        for window in (8, 1):
            motions.align(HELDOUT, lambda camera: RENDERER(plain.gaussians, camera).color[0], photograph, window=window)
        aligned = RENDERER(plain.gaussians, motions.now().select([HELDOUT])).color[0]
    lost = float(-10 * (aligned - photograph).square().mean().log10())
    assert plain.heldout.psnr + 1 < lost < exact.heldout.psnr - 1
    assert refined.aligned_psnr > lost + 0.8 * (exact.heldout.psnr - lost)
    assert refined.heldout.psnr < refined.aligned_psnr - 3


def test_exact_cameras_lose_nothing(photographs, exact):
    images, cameras = photographs
    refined = fit(images, cameras, replace(OPTIONS, refine="lenses"))
    # As many depths agree by those that were given: the fit is the one without refinement.
    assert refined.heldout == exact.heldout and exact.aligned_psnr is refined.aligned_psnr is None
    for result in (exact, refined):
        assert torch.equal(result.gaussians.means, exact.gaussians.means)
        assert torch.equal(result.world_from_camera, cameras.world_from_camera[0])
        assert torch.equal(result.intrinsics, cameras.intrinsics[0])


def test_the_frame_and_the_unit_of_the_cameras_stay(photographs):
    _, cameras = photographs
    motions, training = RefinedCameras(cameras, unit=3.0), [0, 1, 2, 5, 7]
    for view in training:
        motions.values["poses"].grad = torch.randn(9, 6, generator=torch.Generator().manual_seed(view))
        motions.step(view, 1e-3, training)
    before, after = (each.world_from_camera[0, training].double() for each in (cameras, motions.now()))
    between = similarity_of_cameras(before, after)
    assert (before - after).abs().max() > 1e-4 and abs(between.scale - 1) < 1e-5
    assert (between.rotation - torch.eye(3)).abs().max() < 1e-5 and between.translation.abs().max() < 1e-5


def test_the_camera_of_one_view_is_found_in_a_scene(photographs):
    images, cameras = photographs
    motions = RefinedCameras(disturbed(cameras), unit=3.0)
    with torch.no_grad():
        for window in (8, 1):
            motions.align(3, lambda camera: RENDERER(wall(), camera).color[0], images[3, None], window=window)
        found = RENDERER(wall(), motions.now().select([3])).color[0]
    assert (found - images[3]).square().mean() < 1e-4


def test_refined_cameras_are_the_same_in_any_order_and_after_a_break(photographs, refined, tmp_path):
    images, given = photographs[0], disturbed(photographs[1])
    order, seen = [3, 8, 0, 5, 4, 1, 7, 2, 6], []  # the fifth is held out in both
    images, given = images[order], given.select(order)

    def stop(progress):
        seen.append(progress.done)
        if len(seen) == 4:  # after it began anew
            raise InterruptedError

    with pytest.raises(InterruptedError):
        fit(images, given, state=tmp_path / "state", on_progress=stop)
    resumed = fit(images, given, state=tmp_path / "state")
    assert torch.equal(refined.gaussians.means, resumed.gaussians.means)
    assert torch.equal(refined.world_from_camera[order], resumed.world_from_camera)
    assert refined.aligned_psnr == resumed.aligned_psnr


def test_a_renderer_without_the_gradient_is_named(photographs):
    images, cameras = photographs

    def without(gaussians, seen):
        return RENDERER(gaussians, replace(seen, intrinsics=seen.intrinsics.detach()))

    options = replace(OPTIONS, num_steps=10, refine="lenses")
    with pytest.raises(UserError, match="no gradient of focal lengths; choose renderer=cpu"):
        fit_photographs(images, cameras, without, num_gaussians=900, options=options)
