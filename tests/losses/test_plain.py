"""Losses on images, depths and colours against closed forms."""

import math

import pytest
import torch

from anystyle.losses.depth_consistency import DepthConsistency
from anystyle.types import Geometry
from anystyle_methods.total_variation import TotalVariation
from anystyle_tiny.losses import EdgeAwareSmoothness
from tests.support.oracle import hashed, smooth_image
from tests.support.style_cases import cameras, stylization

PHOTOGRAPHS = smooth_image(11, [2, 2, 3, 28, 35])


def test_total_variation_of_a_ramp_and_of_a_constant() -> None:
    rising = (torch.arange(35.0) / 100 + torch.arange(28.0)[:, None] / 50).expand(2, 2, 3, 28, 35)
    assert TotalVariation()(stylization(rising, rising)).item() == pytest.approx(0.01**2 + 0.02**2, rel=1e-4)
    summed = 3 * (28 * 34 * 0.01**2 + 27 * 35 * 0.02**2)
    assert TotalVariation(reduction="sum")(stylization(rising, rising)).item() == pytest.approx(summed, rel=1e-4)
    flat = torch.full_like(rising, 0.4)
    assert TotalVariation()(stylization(flat, flat)) == 0


def test_edge_aware_smoothness_of_a_ramp_is_damped_by_the_photographs_own_slope() -> None:
    rising = (torch.arange(35.0) / 100 + torch.arange(28.0)[:, None] / 50).expand(2, 2, 3, 28, 35)
    flat = torch.full_like(rising, 0.4)
    loss = EdgeAwareSmoothness(sharpness=20.0)
    assert loss(stylization(rising, flat)).item() == pytest.approx(0.01 + 0.02, rel=1e-4)
    damped = 0.01 * math.exp(-20 * 0.01) + 0.02 * math.exp(-20 * 0.02)
    assert loss(stylization(rising, rising)).item() == pytest.approx(damped, rel=1e-4)
    assert loss(stylization(flat, rising)) == 0


def test_depth_consistency_is_the_mean_square_against_the_predicted_depth() -> None:
    depth, rendered = hashed(1, [2, 2, 28, 35], 1, 3), hashed(2, [2, 2, 28, 35], 1, 3)
    geometry = Geometry(cameras(2, 2, (28, 35)), depth, torch.ones_like(depth))
    result = stylization(PHOTOGRAPHS, PHOTOGRAPHS, rendered_depth=rendered, geometry=geometry)
    expected = ((rendered - depth) ** 2).sum() / depth.numel()
    torch.testing.assert_close(DepthConsistency()(result), expected)
