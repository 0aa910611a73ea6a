"""Colours by least squares, against the dense solution."""

from dataclasses import replace

import pytest
import torch

from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.methods.colors import fit_colors
from anystyle_cpu_renderer.renderer import CpuRenderer
from renderers.scenes import cameras, gaussians

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
        means = (transposed @ target) / weight
        damped = transposed @ a + 0.02 * torch.diag(weight)
        expected = torch.linalg.solve(damped, transposed @ (target - behind) + 0.02 * weight * means)
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
        result = fit_colors(
            colored(scene, torch.full((40, 3), 0.5)), views, targets, RENDERER, steps=steps, damping=0.0
        )
        errors.append(float((RENDERER(result, views).color[0] - targets).square().mean()))
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-6


def test_what_no_view_sees_keeps_its_color_or_has_that_of_its_pixel():
    scene, views = small_scene()
    hidden = torch.tensor([0, 5])
    scene = replace(scene, opacities=scene.opacities.index_fill(1, hidden, 0.0))
    targets = torch.rand(4, 3, 24, 32)
    result = fit_colors(scene, views, targets, RENDERER, steps=2)
    torch.testing.assert_close(result.harmonics[:, hidden], scene.harmonics[:, hidden])
    origins = torch.stack([torch.arange(12) % 4, torch.arange(12), torch.arange(12) + 7], dim=1)
    painted = fit_colors(scene, views, targets, RENDERER, steps=2, origins=origins)
    expected = torch.stack([targets[0, :, 0, 7], targets[1, :, 5, 12]])
    torch.testing.assert_close(rgb_from_constant(painted.harmonics[0, hidden, 0]), expected)
    assert torch.equal(painted.harmonics[:, 1], result.harmonics[:, 1])
    assert not torch.equal(result.harmonics[:, 1], scene.harmonics[:, 1])
    assert result.means is scene.means or torch.equal(result.means, scene.means)


def test_refuses_what_does_not_belong_together():
    scene, views = small_scene()
    with pytest.raises(ValueError, match="a camera a target"):
        fit_colors(scene, views, torch.rand(3, 3, 24, 32), RENDERER)
    with pytest.raises(ValueError, match="resize one"):
        fit_colors(scene, views, torch.rand(4, 3, 24, 33), RENDERER)


class Counting(CpuRenderer):
    """Counts its renders."""

    calls = 0

    def __call__(self, *scene):
        self.calls += 1
        return super().__call__(*scene)


def test_a_second_style_of_a_scene_needs_fewer_renders_and_comes_to_the_same():
    scene, views = small_scene()
    pictures = torch.rand(2, 4, 3, 24, 32, generator=torch.Generator().manual_seed(0))
    renderer = Counting()
    fit_colors(scene, views, pictures[0], renderer, steps=2)
    first = renderer.calls
    result = fit_colors(scene, views, pictures[1], renderer, steps=2)
    assert renderer.calls - first == first - 4
    assert torch.equal(result.harmonics, fit_colors(scene, views, pictures[1], Counting(), steps=2).harmonics)
    moved = replace(scene, means=scene.means + 0.1)
    other = fit_colors(moved, views, pictures[1], renderer, steps=2)
    assert torch.equal(other.harmonics, fit_colors(moved, views, pictures[1], Counting(), steps=2).harmonics)
