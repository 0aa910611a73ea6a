"""Colours by least squares, against the dense solution."""

from dataclasses import replace

import pytest
import torch

from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.io.cache import LRUCache
from anystyle.methods.colors import NEIGHBORS, covering_views, fit_colors, kept_render
from anystyle.testing.oracle import hashed
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.kernels import Kernels
from tests.support.scenes import cameras, gaussians

RENDERER = CpuRenderer(background=(0.2, 0.5, 0.8))


def colored(scene, colors):
    return replace(scene, harmonics=constant_from_rgb(colors)[None, :, None])


def small_scene(number=12, views=4):
    scene = gaussians(1, number)
    return replace(scene, scales=scene.scales * 2), cameras(1, views, (24, 32))


def matrix(scene, views):
    """How much of each pixel of all views each Gaussian covers, by rendering one Gaussian after the other in white."""
    number = scene.means.shape[1]
    black = RENDERER(colored(scene, torch.zeros(number, 3)), views).color[0, :, 0].flatten()
    rows = [RENDERER(colored(scene, torch.eye(number)[i, :, None].expand(-1, 3)), views).color[0, :, 0].flatten()
            for i in range(number)]  # fmt: skip
    return (torch.stack(rows, 1) - black[:, None]).double(), black.double()


def dense_confidence(a, views):
    """The squared share of each pixel that Gaussians make up which no other view shows larger."""
    by_view = a.view(views, -1, a.shape[1])
    largest = by_view.sum(1).argmax(0)
    shares = [by_view[view] @ (largest == view).to(a) for view in range(views)]
    return (torch.cat(shares) + 1e-3).square()


def filled(colors, weight, means):
    """What a Gaussian lacks of a pixel is the mean colour of its nearest neighbours that have one."""
    known = weight >= 1
    result = colors.clone()
    for index in (~known).nonzero()[:, 0]:
        nearest = (means[known] - means[index]).norm(dim=1).argsort()[:NEIGHBORS]
        result[index] += (1 - weight[index]) * (colors[known][nearest].mean() - colors[index])
    return result


@pytest.mark.parametrize("largest", [False, True])
def test_agrees_with_the_dense_solution(largest):
    scene, views = small_scene()
    generator = torch.Generator().manual_seed(0)
    renders = RENDERER(colored(scene, 0.3 + 0.4 * torch.rand(12, 3, generator=generator)), views).color[0]
    targets = renders + 0.05 * torch.randn(renders.shape, generator=generator)
    a, _ = matrix(scene, views)
    result = fit_colors(scene, views, targets, RENDERER, steps=40, damping=0.02, largest=largest)
    confidence = dense_confidence(a, 4) if largest else torch.ones(len(a)).double()
    transposed = a.T * confidence
    actual = rgb_from_constant(result.harmonics[0, :, 0].double())
    for channel in range(3):
        behind = RENDERER(colored(scene, torch.zeros(12, 3)), views).color[0, :, channel].flatten().double()
        target = targets[:, channel].flatten().double()
        weight = transposed.sum(1)
        means = filled((transposed @ target) / weight, weight, scene.means[0])
        pull = 0.02 * weight + (1 - weight).clamp_min(0)
        expected = torch.linalg.solve(transposed @ a + torch.diag(pull), transposed @ (target - behind) + pull * means)
        assert expected.min() > 0 and expected.max() < 1, "a cut colour would say nothing"
        torch.testing.assert_close(actual[:, channel], expected, rtol=0, atol=2e-3)


def test_no_step_gives_weighted_means():
    scene, views = small_scene()
    targets = torch.rand(4, 3, 24, 32, generator=torch.Generator().manual_seed(1))
    a, _ = matrix(scene, views)
    expected = (a.T @ targets.transpose(0, 1).flatten(1).double().T) / a.sum(0)[:, None]
    result = fit_colors(scene, views, targets, RENDERER, steps=0)
    torch.testing.assert_close(rgb_from_constant(result.harmonics[0, :, 0].double()), expected, rtol=0, atol=1e-4)


def test_brings_back_the_colors_of_its_own_renders():
    scene, views = small_scene(number=40, views=8)
    colors = 0.1 + 0.8 * torch.rand(40, 3, generator=torch.Generator().manual_seed(2))
    targets = RENDERER(colored(scene, colors), views).color[0]
    errors = []
    for steps in (0, 2, 8, 60):
        result = fit_colors(colored(scene, torch.full((40, 3), 0.5)), views, targets, RENDERER, steps=steps)
        errors.append(float((RENDERER(result, views).color[0] - targets).square().mean()))
    assert errors == sorted(errors, reverse=True) and errors[-1] < 1e-6


def test_what_no_view_sees_has_the_mean_color_of_its_neighbors():
    scene, views = small_scene()
    hidden = torch.tensor([0, 5])
    scene = replace(scene, opacities=scene.opacities.index_fill(1, hidden, 0.0))
    result = fit_colors(scene, views, torch.rand(4, 3, 24, 32), RENDERER, steps=0)
    others = torch.tensor([index for index in range(12) if index not in hidden])
    for index in hidden:
        distance = (scene.means[0, others] - scene.means[0, index]).norm(dim=1)
        expected = result.harmonics[0, others[distance.argsort()[:NEIGHBORS]]].mean(0)
        torch.testing.assert_close(result.harmonics[0, index], expected)
    assert torch.equal(result.means, scene.means)


def test_what_is_hardly_seen_stays_in_the_range_of_its_neighbors(monkeypatch):
    """Least squares alone would put what is left of the error on it: a share of a pixel takes any colour."""
    scene, views = small_scene()
    renderer, faint = CpuRenderer(background=(0.5, 0.5, 0.5)), torch.tensor([3, 8])
    scene = replace(scene, opacities=scene.opacities.index_fill(1, faint, 0.006))
    targets = 0.5 + 0.1 * torch.randn(4, 3, 24, 32, generator=torch.Generator().manual_seed(0))
    colors = rgb_from_constant(fit_colors(scene, views, targets, renderer, steps=30).harmonics[0, :, 0])
    assert (colors[faint] - 0.5).abs().max() < 0.05
    monkeypatch.setattr("anystyle.methods.colors.EVIDENCE", 1e-6)
    alone = fit_colors(scene.map(torch.clone), views, targets, renderer, steps=30)
    assert (rgb_from_constant(alone.harmonics[0, faint, 0]) - 0.5).abs().max() > 0.3


def test_what_is_shown_nowhere_keeps_its_colors():
    scene, views = small_scene()
    scene = replace(scene, opacities=torch.zeros_like(scene.opacities))
    assert torch.equal(fit_colors(scene, views, torch.rand(4, 3, 24, 32), RENDERER).harmonics, scene.harmonics)


def test_refuses_what_does_not_belong_together():
    scene, views = small_scene()
    with pytest.raises(ValueError, match="a camera a target"):
        fit_colors(scene, views, torch.rand(3, 3, 24, 32), RENDERER)
    with pytest.raises(ValueError, match="resize one"):
        fit_colors(scene, views, torch.rand(4, 3, 24, 33), RENDERER)


class Differentiable(CpuRenderer):
    """Has no linear views of its own; counts its renders."""

    calls = 0

    def __call__(self, *scene):
        self.calls += 1
        return super().__call__(*scene)

    def linear_view(self, *scene):
        return None


def test_gradients_stand_for_mixtures_and_serve_every_style():
    scene, views = small_scene()
    pictures = torch.rand(2, 4, 3, 24, 32, generator=torch.Generator().manual_seed(0))
    renderer, how = Differentiable(background=(0.2, 0.5, 0.8)), {"steps": 2, "largest": True}
    first = fit_colors(scene, views, pictures[0], renderer, **how)
    calls = renderer.calls
    result = fit_colors(scene, views, pictures[1], renderer, **how)
    assert renderer.calls - calls == calls - 3 * 4  # two renders a view make it linear, one says what is largest
    same = fit_colors(scene, views, pictures[0], RENDERER, **how)  # in steps of 1 / 65535
    torch.testing.assert_close(first.harmonics, same.harmonics, rtol=0, atol=1e-3)
    fresh = Differentiable(background=(0.2, 0.5, 0.8))
    assert torch.equal(result.harmonics, fit_colors(scene, views, pictures[1], fresh, **how).harmonics)
    moved = replace(scene, means=scene.means + 0.1)
    other = fit_colors(moved, views, pictures[1], renderer, **how)
    assert torch.equal(other.harmonics, fit_colors(moved, views, pictures[1], fresh, **how).harmonics)


def test_gaussians_that_a_fused_optimiser_moved_are_seen():
    scene, views = small_scene()
    leaves, pictures = scene.map(lambda tensor: tensor.clone().requires_grad_()), torch.rand(4, 3, 24, 32)
    before = fit_colors(leaves, views, pictures, RENDERER)
    leaves.scales.sum().backward()
    torch.optim.Adam([leaves.scales], lr=0.01, fused=True).step()
    after = fit_colors(leaves, views, pictures, RENDERER)
    assert torch.equal(after.harmonics, fit_colors(leaves.map(torch.clone), views, pictures, RENDERER).harmonics)
    assert not torch.equal(after.harmonics, before.harmonics)


def test_a_further_style_reads_the_cameras_back_once(monkeypatch):
    """And whether anything is shown; on a card each such read waits, and there are views times steps of products."""
    scene, views = small_scene()
    renderer, pictures = CpuRenderer(), torch.rand(2, 4, 3, 24, 32)
    fit_colors(scene, views, pictures[0], renderer, largest=True)
    reads, cpu = [], torch.Tensor.cpu
    monkeypatch.setattr(torch.Tensor, "cpu", lambda tensor: reads.append(tensor.shape) or cpu(tensor))
    with Kernels() as kernels:
        fit_colors(scene, views, pictures[1], renderer, largest=True)
    assert reads == [(4, 4, 4), (4, 3, 3)] and kernels.waits == 1


def test_few_views_cover_a_scene():
    scene, views = small_scene(views=6)
    pixels = matrix(scene, views)[0].view(6, -1, scene.means.shape[1]).sum(1)
    largest = pixels.amax(0)
    for share in (0.5, 0.9, 1.0):
        chosen = covering_views(scene, views, RENDERER, share=share, most=6)
        shown = (2 * pixels[chosen].amax(0)).minimum(largest).sum() / largest.sum()
        assert shown >= share - 1e-5 and chosen == sorted(set(chosen))
    first = covering_views(scene, views, RENDERER, share=1.0, most=1)
    assert first == [int((2 * pixels).minimum(largest).sum(1).argmax())]
    assert covering_views(scene, views.select([*range(6), *range(6)]), RENDERER, share=1.0, most=12) == chosen


def test_what_does_not_fit_into_memory_is_rendered_again(monkeypatch):
    scene, views = small_scene(views=3)
    targets = hashed(5, (3, 3, *views.size))
    kept, again = [], []
    for results, limit in ((kept, 10**9), (again, 0)):
        monkeypatch.setattr("anystyle.methods.colors.KEPT", limit)
        for cache in ("_SYSTEMS", "_VIEWS"):
            monkeypatch.setattr(f"anystyle.methods.colors.{cache}", LRUCache(1))
        results.append(fit_colors(scene, views, targets, RENDERER, steps=2, largest=True).harmonics)
    assert torch.equal(*kept, *again)


def test_some_of_many_gaussians_choose_the_views(monkeypatch):
    scene, views = small_scene(views=6)
    monkeypatch.setattr("anystyle.methods.colors.COUNTED", -(-scene.means.shape[1] // 2))
    pixels = matrix(scene, views)[0].view(6, -1, scene.means.shape[1]).sum(1)[:, ::2]
    chosen = covering_views(scene, views, RENDERER, share=0.9, most=6)
    largest = pixels.amax(0)
    assert (2 * pixels[chosen].amax(0)).minimum(largest).sum() >= (0.9 - 1e-5) * largest.sum()


def test_renders_of_solved_colors_come_from_the_views_that_they_were_solved_with():
    scene, views = small_scene()
    targets = torch.rand(4, 3, 24, 32, generator=torch.Generator().manual_seed(0))
    solved = fit_colors(scene, views, targets, RENDERER)
    for view in range(4):
        rendered = kept_render(solved, views.select([view]), RENDERER)
        assert rendered is not None
        torch.testing.assert_close(rendered, RENDERER(solved, views.select([view])).color[0, 0], rtol=0, atol=1e-4)
    copied = replace(solved, means=solved.means.clone())
    higher = replace(solved, harmonics=solved.harmonics.repeat(1, 1, 4, 1))
    assert all(kept_render(other, views.select([0]), RENDERER) is None for other in (copied, higher))
    assert kept_render(solved, views.select([0]).resized((12, 16)), RENDERER) is None
    assert kept_render(solved, views.select([0]), CpuRenderer()) is None
