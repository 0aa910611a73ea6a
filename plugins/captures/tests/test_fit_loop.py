"""Gaussians fitted to renders of a scene that is known."""

from dataclasses import replace
from math import radians

import pytest
import torch
from torch.nn.functional import pad

from anystyle.geometry.transforms import matrix_from_vector
from anystyle_captures import fit_loop
from anystyle_captures.fit_loop import Exposures, FitLoop, FitOptions, InitialScene
from anystyle_captures.initial import OPACITY, InitialGaussians, backdrop, from_stereo, lift
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.kernels import Kernels
from tests.support.known_scene import photographed_wall, rig, stereo_of

RENDERER = CpuRenderer(background=(0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def photographs():
    return photographed_wall()


def initial(photographs, views=(0, 1, 2, 4, 5, 6), num_gaussians=900):
    images, cameras, depth = photographs
    index = list(views)
    stereo = stereo_of(depth[index])
    generator = torch.Generator().manual_seed(0)
    return from_stereo(
        images[index], cameras.select(index), stereo, num_gaussians=num_gaussians, unsupported=0.0, generator=generator
    )


def fit(photographs, options, heldout=(3,)):
    images, cameras, _ = photographs
    return FitLoop(images, cameras, InitialScene(initial(photographs)), RENDERER, options, heldout=heldout)


def test_lifted_pixels_lie_where_their_cameras_see_them(photographs):
    images, cameras, depth = photographs
    pixels = torch.tensor([[0, 3, 5], [2, 39, 47], [6, 20, 0]])
    lifted = lift(images, cameras, depth[pixels.unbind(1)], pixels)
    for i, (view, y, x) in enumerate(pixels.tolist()):
        local = cameras.camera_from_world[0, view] @ torch.cat([lifted.means[i], torch.ones(1)])
        image = cameras.intrinsics[0, view] @ local[:3]
        torch.testing.assert_close(image[:2] / image[2], torch.tensor([x + 0.5, y + 0.5]), rtol=0, atol=1e-3)
        torch.testing.assert_close(local[2], depth[view, y, x])
        torch.testing.assert_close(lifted.colors[i], images[view, :, y, x])
        torch.testing.assert_close(lifted.footprints[i], depth[view, y, x] / 50)


def test_only_supported_pixels_are_lifted(photographs):
    images, cameras, depth = photographs
    support = torch.zeros(depth.shape, dtype=torch.int32)
    support[:, :20] = 2
    stereo = stereo_of(depth, support)
    generator = torch.Generator().manual_seed(0)
    lifted = from_stereo(images, cameras, stereo, num_gaussians=2000, unsupported=0.0, generator=generator)
    assert lifted.pixels[:, 1].max() < 20 and abs(len(lifted.means) / 2000 - 1) < 0.15
    assert set(lifted.pixels[:, 0].tolist()) == set(range(7))
    with pytest.raises(ValueError, match="no depth is supported"):
        from_stereo(
            images, cameras, replace(stereo, support=0 * support), num_gaussians=9, unsupported=1.0, generator=generator
        )


def test_a_view_held_out_comes_out(photographs):
    """A fit gains several dB on a view that it never saw, and is reported as it renders."""
    loop, reports = fit(photographs, FitOptions(num_steps=120, evaluate_every=40)), []
    before, result = loop.heldout_quality(), loop.run(reports.append)
    assert before is not None and result.heldout is not None
    assert result.heldout.psnr > before.psnr + 3 and result.heldout.psnr > 24
    assert result.heldout.ssim > before.ssim and result.heldout.matched_psnr > result.heldout.psnr
    assert [round(120 * report.done) for report in reports] == [40, 80, 120]
    assert reports[-1].line == f"step 120 of 120: {result.heldout.psnr:.1f} dB on views held out, 0 s left"
    images, cameras, _ = photographs
    render = RENDERER(result.gaussians, cameras.select([3])).color[0]
    exposed = (render * result.gains[3, :, None, None] + result.biases[3, :, None, None]).clamp(0, 1)
    mse = (exposed - images[3]).square().mean()
    assert abs(float(-10 * mse.log10()) - result.heldout.psnr) < 1e-3


def test_exposure_is_told_apart_from_color(photographs):
    """Photographs of different exposure give one scene, and the gains that were applied."""
    images, cameras, depth = photographs
    gains = torch.tensor([0.8, 1.2, 0.9, 1.1, 1.0, 0.85, 1.15])
    dimmed = (images * (0.7 * gains)[:, None, None, None]).clamp(0, 1)
    options = FitOptions(num_steps=200, evaluate_every=200, exposure_lr=0.01)
    plain = fit((dimmed, cameras, depth), replace(options, exposure_lr=0.0), heldout=()).run()
    result = fit((dimmed, cameras, depth), options, heldout=()).run()
    assert result.train_psnr > plain.train_psnr + 1
    # A gain and a bias can stand in for one another: what they do to the mean colour is compared.
    ratio = (result.gains * images.mean((0, 2, 3)) + result.biases).mean(1) / gains
    assert float(ratio.std() / ratio.mean()) < 0.05
    assert torch.all(plain.gains == 1)


def test_a_view_held_out_has_the_exposure_of_those_beside_it():
    exposures = Exposures(rig(), [0, 2, 4, 6])
    with torch.no_grad():
        exposures.values[2], exposures.values[4] = 0.2, 0.4
    torch.testing.assert_close(exposures.of(3), torch.full((6,), 0.3), rtol=0, atol=0.02)
    assert torch.equal(exposures.of(2), exposures.values[2])


def test_a_step_leaves_out_some_gaussians_and_the_others_stand_in(photographs):
    images, cameras, _ = photographs
    drawn = []

    def renderer(gaussians, seen):
        drawn.append(gaussians.opacities.detach())
        return RENDERER(gaussians, seen)

    FitLoop(images, cameras, InitialScene(initial(photographs)), renderer, FitOptions(dropout=0.2)).advance()
    kept = drawn[-1] > 0
    assert abs(float(kept.float().mean()) - 0.8) < 0.05
    torch.testing.assert_close(drawn[-1], OPACITY / 0.8 * kept)


def test_a_step_waits_for_nothing(photographs):
    """On a card, which computes while its host goes on, values are read back where progress is told and no oftener."""
    loop = fit(photographs, FitOptions(num_steps=20))
    with Kernels() as kernels:
        for _ in range(6):
            loop.advance()
    assert kernels.count > 6 and kernels.waits == 0


@pytest.mark.parametrize("turn", [0.0, radians(180)], ids=["half seen", "nothing seen"])
def test_a_held_out_view_adds_nothing_where_the_scene_shows_nothing(photographs, turn):
    images, cameras, _ = photographs
    pose = cameras.world_from_camera.clone()
    pose[0, 6, :3, :3] @= matrix_from_vector(torch.tensor([0.0, turn, 0.0]))
    turned = replace(cameras, world_from_camera=pose)
    start = initial(photographs, views=(0,), num_gaussians=300)
    start = start.map(lambda values: values[start.pixels[:, 2] < images.shape[-1] // 2])
    options = FitOptions(num_steps=1, final_steps=1)
    result = FitLoop(images, turned, InitialScene(start), RENDERER, options, heldout=(6,)).run(lambda _: None)
    assert all(values.isfinite().all() for values in vars(result.gaussians).values() if values is not None)
    depth = (torch.linalg.inv(pose[0, 6]) @ torch.nn.functional.pad(result.gaussians.means[0], (0, 1), value=1.0).T)[2]
    assert depth.abs().min() > 0.1


def test_what_shows_nothing_is_removed_and_nothing_else_far_from_the_origin(photographs, monkeypatch):
    """Such as in coordinates of a map."""
    monkeypatch.setattr(fit_loop, "PRUNE_EVERY", 1)
    images, cameras, _ = photographs
    away, lifted = torch.tensor([8000.0, 8000.0, 0.0]), initial(photographs)
    lifted = replace(lifted, means=lifted.means + away)
    cameras = replace(cameras, world_from_camera=cameras.world_from_camera + pad(away[:, None], (3, 0, 0, 1)))
    run = FitLoop(images, cameras, InitialScene(lifted), RENDERER, FitOptions(num_steps=50))
    with torch.no_grad():
        run.splats.parameters["opacities"][10:30] = -9.0
        run.splats.parameters["scales"][40] = 5.0
    run.advance()
    keep = [i for i in range(len(lifted.means)) if not 10 <= i < 30 and i != 40]
    assert torch.equal(run.splats.units, lifted.footprints[keep])
    assert all(len(value) == len(keep) for value in run.splats.parameters.values())
    run.advance()


def test_a_view_that_looks_past_the_photographs_sees_no_hole(photographs):
    """Beside what they show, the backdrop goes on in the colours of their borders."""
    images, cameras, depth = photographs
    stereo = stereo_of(depth)
    behind = backdrop(images, cameras, stereo, num_gaussians=60, generator=torch.Generator().manual_seed(0))
    views, rows, columns = behind.pixels.unbind(1)
    assert len(views) == 60 and torch.equal(behind.colors, images[views, :, rows, columns])
    height, width = cameras.size
    assert ((rows % (height - 1) == 0) | (columns % (width - 1) == 0)).all(), "all depths are supported"
    first = InitialScene(InitialGaussians.cat([initial(photographs), behind]))
    run = FitLoop(images, cameras, first, RENDERER, FitOptions(num_steps=60))
    run.run()
    # The image is 51 degrees wide.
    aside = matrix_from_vector(torch.tensor([0.0, radians(40), 0.0]))
    pose = cameras.world_from_camera.clone()
    pose[..., :3, :3] @= aside
    turned = replace(cameras, world_from_camera=pose).select([6])
    with torch.no_grad():
        alpha = RENDERER(run.gaussians(), turned).alpha[0, 0]
        bare = RENDERER(fit(photographs, FitOptions(num_steps=1)).gaussians(), turned).alpha[0, 0]
    assert bare.amin(0).min() < 0.05 and alpha.quantile(0.02) > 0.99
