"""From posed photographs to fitted Gaussians: what is held out, quality, and fits that are broken off."""

from dataclasses import replace

import pytest
import torch
from torch.nn.functional import interpolate, pad

from anystyle.renderers.auto import AutoRenderer
from anystyle_captures import fit as captures_fit
from anystyle_captures.fit import fit_photographs
from anystyle_captures.fit_loop import FitOptions
from tests.support.known_scene import photographed_wall

OPTIONS = FitOptions(num_steps=60, evaluate_every=20, final_steps=10)
RENDERER = AutoRenderer(background=(1.0, 0.5, 0.0))


@pytest.fixture(scope="module")
def photographs():
    return photographed_wall(num_views=9)


def fit(photographs, options=OPTIONS, renderer=RENDERER, **rest):
    images, cameras, _ = photographs
    return fit_photographs(images, cameras, renderer, num_gaussians=900, options=options, heldout=(4,), **rest)


@pytest.fixture(scope="module")
def whole(photographs):
    """A fit that nothing interrupts."""
    return fit(photographs)


def test_photographs_alone_give_a_view_that_was_held_out(photographs, whole):
    """Stereo finds the wall, and the fit shows it from where no photograph was taken."""
    assert whole.steps == 70 and whole.heldout.psnr > 22
    assert fit(photographs, replace(OPTIONS, num_steps=150)).heldout.psnr > whole.heldout.psnr


def test_the_final_steps_begin_with_gaussians_of_the_views_held_out(photographs, whole):
    images, cameras, _ = photographs

    def psnr(result):
        render = RENDERER(result.gaussians, cameras.select([4])).color[0, 0]
        exposed = render * result.gains[4, :, None, None] + result.biases[4, :, None, None]
        return float(-10 * (exposed - images[4]).square().mean().log10())

    before, after = fit(photographs, replace(OPTIONS, final_steps=0)), whole
    assert before.heldout == after.heldout
    assert 1.05 < after.gaussians.means.shape[1] / before.gaussians.means.shape[1] < 1.2  # one of nine views
    assert psnr(after) > psnr(before) + 0.5


def test_stereo_reads_small_images_and_what_it_finds_lies_where_the_photographs_show_it(photographs, monkeypatch):
    images, cameras, _ = photographs
    given = images, None, None, 900, 0, cameras
    whole = captures_fit._initial(*given, range(9)).gaussians
    monkeypatch.setattr(captures_fit, "STEREO_SIDE", min(images.shape[-2:]) // 2)
    for initial in (whole, captures_fit._initial(*given, range(9)).gaussians):
        view, row, column = initial.pixels.unbind(1)
        local = torch.einsum("nij,nj->ni", cameras.camera_from_world[0, view], pad(initial.means, (0, 1), value=1.0))
        image = torch.einsum("nij,nj->ni", cameras.intrinsics[0, view], local[:, :3])
        position = image[:, :2] / image[:, 2:]
        inside = ((position > 0) & (position < torch.tensor([images.shape[-1], images.shape[-2]]))).all(1)
        assert 500 < inside.sum() < len(inside)
        scale = 1 if initial is whole else 2
        assert (position - scale * (torch.stack([column, row], dim=1) + 0.5))[inside].abs().max() < 0.01
        torch.testing.assert_close(initial.footprints, local[:, 2] / cameras.intrinsics[0, view, 0, 0])


def test_a_fit_is_the_same_in_any_order_of_photographs(photographs, whole, tmp_path, monkeypatch):
    """Bit for bit, with the views that pixels come from and their exposures; the cache serves every order.

    It serves a renderer that has rendered, and one that has not.
    """
    monkeypatch.setenv("ANYSTYLE_CACHE", str(tmp_path))
    images, cameras, _ = photographs
    order = [3, 8, 0, 5, 4, 1, 7, 2, 6]  # the fifth is held out in both
    first, other = whole, fit((images[order], cameras.select(order), None))
    assert torch.equal(first.gaussians.means, other.gaussians.means)
    assert torch.equal(first.gaussians.harmonics, other.gaussians.harmonics)
    assert torch.equal(first.gains[order], other.gains) and torch.equal(first.biases[order], other.biases)
    assert first.gains.std() > 0
    moved = images[order], cameras.select(order), None
    again = fit(photographs, keep=True), fit(moved, renderer=replace(RENDERER), keep=True)
    assert [result.cached for result in again] == [False, True] and torch.equal(again[1].gains, other.gains)


@pytest.mark.parametrize(
    "steps", [pytest.param(20, marks=pytest.mark.slow), 60], ids=["amid the fit", "before the final steps"]
)
def test_a_fit_that_was_broken_off_comes_to_the_same(photographs, whole, tmp_path, steps):
    def stop(progress):
        if progress.done > steps / whole.steps:
            raise InterruptedError

    state = tmp_path / "fit.state"
    with pytest.raises(InterruptedError):
        fit(photographs, state=state, on_progress=stop)
    assert state.is_file()
    seen = []
    resumed = fit(photographs, state=state, on_progress=lambda progress: seen.append(progress.done))
    assert min(seen) > steps / whole.steps and not state.exists()
    for name, value in vars(whole.gaussians).items():
        assert torch.equal(value, getattr(resumed.gaussians, name)), name
    assert whole.heldout == resumed.heldout and torch.equal(whole.gains, resumed.gains)


def test_photographs_that_do_not_teach_each_other_leave_more_gaussians_out(photographs, tmp_path):
    """A trial that sees every second photograph tells; a fit that was broken off goes on with what it told."""
    images, cameras, points = photographs
    generator = torch.Generator().manual_seed(0)
    noise = torch.rand(len(images), 1, images.shape[-2] // 4, images.shape[-1] // 4, generator=generator)
    spoiled = (images + interpolate(noise, images.shape[-2:]) - 0.5).clamp(0, 1), cameras, points
    unseen = 1, 3, 6, 8
    assert fit(photographs, unseen=unseen).dropout == OPTIONS.dropout
    assert fit(spoiled).dropout == OPTIONS.dropout
    whole = fit(spoiled, unseen=unseen)
    assert whole.dropout > 2 * OPTIONS.dropout

    def stop(progress):
        raise InterruptedError

    with pytest.raises(InterruptedError):
        fit(spoiled, unseen=unseen, state=tmp_path / "state", on_progress=stop)
    assert fit(spoiled, unseen=unseen, state=tmp_path / "state").heldout == whole.heldout


def test_a_file_that_is_no_state_is_left_as_it_is(photographs, tmp_path):
    state = tmp_path / "fit.state"
    state.write_bytes(b"something else")
    with pytest.raises(ValueError, match=r"fit\.state is not a valid state of a fit"):
        fit(photographs, state=state)
    assert state.read_bytes() == b"something else"
