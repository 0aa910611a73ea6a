"""Masks in a fit: nothing is built where photographs are transparent, and nothing learnt where they are ignored."""

from dataclasses import replace

import pytest
import torch

from anystyle.methods.colors import fit_colors
from anystyle.types import Views
from anystyle_captures.fit import fit_photographs, to_paint, unlike_most
from anystyle_captures.fit_loop import FitOptions
from anystyle_captures.masks import Masks
from anystyle_captures.stereo import plane_sweep
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.known_scene import photographed_wall

RENDERER = CpuRenderer(background=(0.0, 0.0, 0.0))
OPTIONS = FitOptions(num_steps=80, evaluate_every=80)


@pytest.fixture(scope="module")
def photographs():
    return photographed_wall(num_views=9)


def disc(size=(40, 48)):
    y, x = torch.meshgrid(torch.arange(size[0]) + 0.5, torch.arange(size[1]) + 0.5, indexing="ij")
    away = ((y - size[0] / 2).square() + (x - size[1] / 2).square()).sqrt()
    return (14.5 - away).clamp(0, 1).expand(9, -1, -1)


def alpha_of(result, cameras):
    with torch.no_grad():
        return RENDERER(result.gaussians, cameras).alpha[0]


def test_nothing_is_built_where_photographs_are_transparent(photographs):
    images, cameras, _ = photographs
    alpha = disc()
    over_white = images * alpha[:, None] + 1 - alpha[:, None]
    masks = Masks(alpha, torch.ones_like(alpha, dtype=torch.bool))
    given = {"num_gaussians": 900, "options": OPTIONS, "heldout": (4,)}
    cut = fit_photographs(over_white, cameras, RENDERER, masks=masks, **given)
    wall = fit_photographs(over_white, cameras, RENDERER, **given)
    empty = alpha == 0
    assert alpha_of(wall, cameras)[empty].mean() > 0.5  # the white surround, without masks
    assert alpha_of(cut, cameras)[empty].mean() < 0.05 and alpha_of(cut, cameras)[alpha == 1].mean() > 0.8
    assert cut.heldout.psnr > 20
    # Over black, the object's edge is as dark as the object there, and not white.
    edge = (alpha > 0.3) & (alpha < 0.7)
    with torch.no_grad():
        shown = RENDERER(cut.gaussians, cameras).color[0].movedim(1, -1)[edge]
    assert (shown - images.movedim(1, -1)[edge] * alpha[edge][:, None]).mean() < 0.1


def test_a_trial_that_would_see_nothing_is_left_out(photographs):
    images, cameras, _ = photographs
    valid = torch.ones(images[:, 0].shape, dtype=torch.bool)
    valid[::2] = False
    given = {"num_gaussians": 900, "options": OPTIONS, "masks": Masks(torch.ones_like(images[:, 0]), valid)}
    tried = fit_photographs(images, cameras, RENDERER, unseen=(1, 3, 5, 7), **given)
    assert torch.equal(tried.gaussians.means, fit_photographs(images, cameras, RENDERER, **given).gaussians.means)


def test_what_is_ignored_is_neither_learnt_nor_measured_and_other_photographs_fill_it(photographs):
    """A red figure stands elsewhere in each photograph."""
    images, cameras, _ = photographs
    valid, spoiled = torch.ones(images[:, 0].shape, dtype=torch.bool), images.clone()
    for view in range(9):
        valid[view, 10:30, 3 + 4 * view : 12 + 4 * view] = False
    spoiled = torch.where(valid[:, None], images, torch.tensor([1.0, 0.0, 0.0])[:, None, None])
    masks = Masks(torch.ones_like(images[:, 0]), valid)
    given = {"num_gaussians": 900, "options": OPTIONS, "heldout": (4,)}
    masked = fit_photographs(spoiled, cameras, RENDERER, masks=masks, **given)
    plain = fit_photographs(spoiled, cameras, RENDERER, **given)
    clean = fit_photographs(images, cameras, RENDERER, **given)
    assert masked.heldout.psnr > plain.heldout.psnr + 1 and masked.heldout.psnr > clean.heldout.psnr - 1
    assert (RENDERER(masked.gaussians, cameras).color[0].detach() - images).abs().mean(1)[~valid].mean() < 0.12
    painted = to_paint(Views(spoiled[None], cameras, valid=valid[None]), masked, RENDERER).images[0]
    assert (painted - images).abs().mean(1)[~valid].mean() < 0.12
    assert torch.equal(painted.movedim(1, -1)[valid], images.movedim(1, -1)[valid])


def test_what_was_moved_before_one_photograph_is_not_painted_on(photographs):
    images, cameras, _ = photographs
    moved = images.clone()
    moved[3, :, 14:40, 10:34] = torch.tensor([1.0, 0.0, 0.0])[:, None, None]
    fitted = fit_photographs(moved, cameras, RENDERER, num_gaussians=900, options=OPTIONS)
    named = unlike_most(fitted.unexplained, float(fitted.unexplained.nanmedian()))
    painted = to_paint(Views(moved[None], cameras), fitted, RENDERER, named).images[0]
    others = [view for view in range(9) if view != 3]
    assert named == [3] and torch.equal(painted[others], images[others])
    before, after = ((given[3] - images[3]).abs().mean(0)[14:40, 10:34].mean() for given in (moved, painted))
    assert after < 0.3 * before
    assert torch.equal(to_paint(Views(moved[None], cameras), fitted, RENDERER).images[0], moved)


def test_hidden_colors_change_nothing(photographs):
    """Neither in stereo nor in the fit: what is ignored may be any colour."""
    images, cameras, _ = photographs
    valid = disc() == 1
    noise = torch.rand(images.shape, generator=torch.Generator().manual_seed(1))
    others = torch.where(valid[:, None], images, noise)
    first, second = (plane_sweep(given, cameras, valid=valid) for given in (images, others))
    assert torch.equal(first.support, second.support) and not first.support[~valid].any()
    assert first.depth.isfinite().equal(valid)
    torch.testing.assert_close(first.depth, second.depth, equal_nan=True)


def test_masks_are_part_of_what_a_cached_fit_is_known_by(photographs, tmp_path, monkeypatch):
    monkeypatch.setenv("ANYSTYLE_CACHE", str(tmp_path))
    images, cameras, _ = photographs
    masks = Masks(disc(), torch.ones_like(disc(), dtype=torch.bool))
    given = {"num_gaussians": 300, "options": replace(OPTIONS, num_steps=2), "keep": True}
    fits = [fit_photographs(images, cameras, RENDERER, masks=one, **given) for one in (None, masks, None, masks)]
    assert [fit.cached for fit in fits] == [False, False, True, True]
    order = [3, 8, 0, 5, 4, 1, 7, 2, 6]
    again = fit_photographs(images[order], cameras.select(order), RENDERER, masks=masks.select(order), **given)
    assert again.cached


def test_colors_at_an_edge_are_those_of_what_is_there(photographs):
    """Styled pictures are opaque; what they paint beside an object does not colour it."""
    images, cameras, _ = photographs
    alpha = disc()
    masks = Masks(alpha, torch.ones_like(alpha, dtype=torch.bool))
    over_white = images * alpha[:, None] + 1 - alpha[:, None]
    fit = fit_photographs(over_white, cameras, RENDERER, num_gaussians=900, options=OPTIONS, masks=masks)
    red, green = (torch.tensor(color)[:, None, None] for color in ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0]))
    painted = torch.where(alpha[:, None] > 0, red, green.expand_as(images))
    colored = fit_colors(fit.gaussians, cameras, painted, RENDERER, largest=True, alpha=alpha)
    assert (colored.harmonics[0, :, 0, 1].detach() * 0.28209479 + 0.5).quantile(0.95) < 0.1
