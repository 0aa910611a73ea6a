"""What the renderer keeps between renders changes nothing."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch

from anystyle.testing.inputs import cameras, gaussians
from anystyle_cpu_renderer.renderer import CpuRenderer


@pytest.mark.parametrize("changed", ["rotations", "scales"])
@pytest.mark.parametrize("by", [torch.Tensor.numpy, lambda tensor: tensor], ids=["numpy", "torch"])
def test_shapes_changed_in_place_are_seen(changed: str, by: Callable[[torch.Tensor], Any]) -> None:
    scene, seen, renderer = gaussians(1, 50), cameras(1, 1, (40, 40)), CpuRenderer()
    before = renderer(scene, seen).color
    tensor = getattr(scene, changed)
    by(tensor)[:, ::2] *= by(torch.tensor([0.5, 2.0, 0.3, 1.5])[: tensor.shape[-1]])
    after = renderer(scene, seen).color
    fresh = renderer(scene.map(torch.clone), seen).color
    assert not torch.equal(before, after) and torch.equal(after, fresh)


def test_a_view_that_waits_for_its_gradient_keeps_its_splats() -> None:
    scene, renderer = gaussians(1, 50), CpuRenderer()
    seen, other = cameras(1, 1, (40, 40)), cameras(1, 2, (40, 40)).select([1])
    gradients = []
    for between in (False, True):
        means = scene.means.clone().requires_grad_()
        image = renderer(replace(scene, means=means), seen).color
        if between:
            renderer(gaussians(1, 80), other)
        image.square().sum().backward()
        gradients.append(means.grad)
    assert torch.equal(*gradients)
