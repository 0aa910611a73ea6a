"""The losses of the tiny experiments against closed forms."""

import math

import pytest
import torch

from anystyle.testing.oracle import smooth_image
from anystyle_tiny.losses import Checkerboard
from tests.support.style_cases import stylization


def test_a_pattern_that_repeats_with_the_patches_costs_its_mean_amplitude() -> None:
    photographs = smooth_image(13, [1, 2, 3, 56, 70])
    wave = 0.1 * torch.sin(2 * math.pi * (torch.arange(70) + 0.5) / 14)
    result = stylization(photographs + wave, photographs)
    assert Checkerboard(period=14)(result).item() == pytest.approx(wave[:14].abs().mean().item(), rel=1e-4)


def test_tints_and_strokes_of_another_period_cost_nothing() -> None:
    photographs = smooth_image(13, [1, 2, 3, 56, 56])
    loss = Checkerboard(period=14)
    assert loss(stylization(photographs * 0 + 0.3 + photographs, photographs)).item() == pytest.approx(0, abs=1e-6)
    waves = 0.1 * torch.sin(2 * math.pi * (torch.arange(56) + 0.5) / 8)  # 7 of them in the 4 patches of a row
    assert loss(stylization(photographs + waves, photographs)).item() == pytest.approx(0, abs=1e-6)
