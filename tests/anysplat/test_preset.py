"""The tiny preset: the same code, at a size that a processor trains."""

import pytest
import torch

from anystyle.contracts import Backbone
from anystyle.registry.build import build
from anystyle.registry.compose import compose
from anystyle.types import Views
from anystyle_anysplat import AnySplat
from oracle import smooth_image


@pytest.fixture(scope="module")
def tiny() -> Backbone:
    torch.manual_seed(0)
    return build(Backbone, compose("stylize", ["backbone=anysplat_tiny"]).backbone).eval()


def test_it_is_the_network_at_a_thousandth_of_the_size(tiny: Backbone) -> None:
    assert type(tiny) is AnySplat
    assert 4e6 < sum(parameter.numel() for parameter in tiny.parameters()) < 5e6


def test_photographs_of_its_size_become_one_gaussian_a_visible_voxel(tiny: Backbone) -> None:
    views = Views(smooth_image(1, (1, 2, 3, tiny.resolution, tiny.resolution + 2 * tiny.patch_size)))
    with torch.no_grad():
        scene = tiny.encode(views)
    assert scene.clusters is not None
    pixels = scene.clusters.index.shape[1]
    # Two views of one plane: voxels are about a pixel's footprint, so up to half of the pixels find a partner.
    assert 0.4 * pixels < scene.clusters.means.shape[1] <= pixels
    depth = scene.geometry.depth.mean().item()
    assert depth == pytest.approx(1, abs=0.05)


def test_options_are_checked_where_they_are_written() -> None:
    with pytest.raises(ValueError, match="conv"):
        compose("stylize", ["backbone=anysplat_tiny", "backbone.embed=linear"])
    with pytest.raises(ValueError, match="deph"):
        compose("stylize", ["backbone=anysplat_tiny", "backbone.deph=3"])
