"""Losses on images, depths and colours against closed forms."""

import math

import pytest
import torch

from anystyle_methods.total_variation import TotalVariation
from anystyle_tiny.losses import EdgeAwareSmoothness
from tests.support.style_cases import stylization

RISING = (torch.arange(35.0) / 100 + torch.arange(28.0)[:, None] / 50).expand(2, 2, 3, 28, 35)
FLAT = torch.full_like(RISING, 0.4)


def test_total_variation_of_a_ramp_and_of_a_constant() -> None:
    assert TotalVariation()(stylization(RISING, RISING)).item() == pytest.approx(0.01**2 + 0.02**2, rel=1e-4)
    summed = 3 * (28 * 34 * 0.01**2 + 27 * 35 * 0.02**2)
    assert TotalVariation(reduction="sum")(stylization(RISING, RISING)).item() == pytest.approx(summed, rel=1e-4)
    assert TotalVariation()(stylization(FLAT, FLAT)) == 0


def test_edge_aware_smoothness_of_a_ramp_is_damped_by_the_photographs_own_slope() -> None:
    loss = EdgeAwareSmoothness(sharpness=20.0)
    assert loss(stylization(RISING, FLAT)).item() == pytest.approx(0.01 + 0.02, rel=1e-4)
    damped = 0.01 * math.exp(-20 * 0.01) + 0.02 * math.exp(-20 * 0.02)
    assert loss(stylization(RISING, RISING)).item() == pytest.approx(damped, rel=1e-4)
    assert loss(stylization(FLAT, RISING)) == 0
