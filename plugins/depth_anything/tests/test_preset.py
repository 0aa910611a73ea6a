"""The tiny preset: the same code, at a size that a processor trains."""

import pytest
import torch

from anystyle.contracts import Backbone
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.types import Views
from oracle import smooth_image


@pytest.fixture(scope="module")
def tiny() -> Backbone:
    torch.manual_seed(0)
    return build(Backbone, compose("stylize", ["backbone=depth_anything_tiny"]).backbone).eval()


def test_photographs_of_its_size_become_one_gaussian_a_pixel(tiny: Backbone) -> None:
    views = Views(smooth_image(1, (1, 3, 3, tiny.resolution, tiny.resolution + 2 * tiny.patch_size)))
    with torch.no_grad():
        scene = tiny.encode(views)
        gaussians = tiny.adapter(scene.attributes, scene.geometry, scene.clusters)
    assert scene.clusters is None
    assert gaussians.means.shape == (1, 3 * tiny.resolution * (tiny.resolution + 28), 3)
    assert scene.geometry.depth.mean().item() == pytest.approx(1, abs=0.05)
