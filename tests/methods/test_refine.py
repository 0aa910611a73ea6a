"""Strokes that Gaussians take after by moving, turning and stretching."""

from dataclasses import replace

import pytest
import torch

import anystyle
from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.methods.branch import Branch
from anystyle.methods.colors import colors_alone, largest_shown
from anystyle.methods.refine import refine
from anystyle.registry.build import build
from anystyle.types import Style, Views
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.scenes import cameras, gaussians

RENDERER = CpuRenderer()


@pytest.fixture(scope="module")
def strokes():
    """A scene, views of it, and what they should show: Gaussians half of their size further, longer and narrower."""
    scene, views = gaussians(1, 40), cameras(1, 4, (48, 64))
    moved = scene.means + 0.5 * scene.scales.mean(-1, keepdim=True) * torch.tensor([1.0, -1.0, 0.0])
    other = replace(scene, means=moved, scales=scene.scales * torch.tensor([1.5, 0.7, 1.0]))
    with torch.no_grad():
        return scene, views, RENDERER(other, views).color[0]


def error(scene, views, targets):
    return float((RENDERER(scene, views).color[0] - targets).abs().mean())


def test_renders_come_nearer_and_opacities_stay(strokes):
    scene, views, targets = strokes
    everywhere = torch.ones(4, 1, 48, 64)
    refined = refine(scene, views, targets, everywhere, RENDERER, steps=80)
    assert error(refined, views, targets) < 0.6 * error(scene, views, targets)
    torch.testing.assert_close(refined.opacities, scene.opacities, rtol=0, atol=0)
    assert refined.means.shape == scene.means.shape
    torch.testing.assert_close(refine(scene, views, targets, everywhere, RENDERER, steps=80).means, refined.means)


def test_pixels_without_confidence_do_not_count(strokes):
    scene, views, targets = strokes
    refined = refine(scene, views, targets, torch.zeros(4, 1, 48, 64), RENDERER, steps=4)
    torch.testing.assert_close(refined.means, scene.means)
    half = largest_shown(scene, views, RENDERER).clone()
    half[:2] = 0
    other = targets.clone()
    other[:2] = 1 - other[:2]
    first, second = (refine(scene, views, pictures, half, RENDERER, steps=8) for pictures in (targets, other))
    assert torch.equal(first.means, second.means) and not torch.equal(first.means, scene.means)


def test_the_painter_refines_a_fitted_scene_and_leaves_others(strokes):
    with pytest.raises(UserError, match="refine_strokes"):
        build(Method, {"_target_": "anystyle.methods.branch.Branch", "refine_strokes": -1})
    scene, views, _ = strokes
    stylizer = anystyle.load("painter")
    images = RENDERER(scene, views).color.detach().clamp(0, 1)
    capture = replace(colors_alone(Views(images, views)), gaussians=scene)
    style = Style(torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(0)))
    embedding = stylizer.embed(image=style.image)
    kept, refined = (Branch(refine_strokes=steps)(stylizer, capture, style, embedding) for steps in (0, 4))
    assert torch.equal(kept.means, scene.means) and not torch.equal(refined.means, scene.means)
