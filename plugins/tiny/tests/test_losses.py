"""The losses of the tiny experiments against closed forms."""

import math

import pytest
import torch

from anystyle.testing.oracle import smooth_image
from anystyle_tiny.losses import Checkerboard, Luminance
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


def test_luminance_ignores_mean_contrast_and_what_is_finer_than_its_scale() -> None:
    loss = Luminance(scales=(8,), scale_weights=(1.0,))
    photographs = smooth_image(13, [1, 1, 3, 56, 56])
    fine = 0.1 * ((torch.arange(56) % 4 < 2).float() - 0.5)  # stripes that average to nothing over 8 pixels
    recoloured = 0.6 * photographs + 0.2 + fine
    assert loss(stylization(recoloured, photographs)).item() == pytest.approx(0, abs=2e-3)
    turned = 1 - photographs
    assert loss(stylization(turned, photographs)).item() == pytest.approx(4, rel=0.05)


def test_luminance_weighs_its_scales() -> None:
    rendered, photographs = smooth_image(15, [1, 2, 3, 56, 56]), smooth_image(13, [1, 2, 3, 56, 56])
    result = stylization(rendered, photographs)
    coarse, fine = (Luminance(scales=(scale,), scale_weights=(1.0,))(result) for scale in (8, 4))
    both = Luminance(scales=(8, 4), scale_weights=(1.0, 0.15))(result)
    torch.testing.assert_close(both, coarse + 0.15 * fine)
    with pytest.raises(ValueError, match="2 scales and 1 weights"):
        Luminance(scale_weights=(1.0,))


def test_luminance_of_a_flat_view_is_finite() -> None:
    flat = torch.full((1, 1, 3, 56, 56), 0.5, requires_grad=True)
    Luminance()(stylization(flat, smooth_image(13, [1, 1, 3, 56, 56]))).backward()
    assert torch.isfinite(flat.grad).all()
