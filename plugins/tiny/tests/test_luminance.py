"""The luminance loss and the ramps of colours against closed forms."""

import numpy as np
import pytest
import torch

from anystyle_tiny.losses import Luminance
from anystyle_tiny.style_encoder import ramp
from oracle import smooth_image
from style_cases import stylization


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


def test_a_ramp_is_the_principal_order_of_the_colours_in_parts_of_equal_size() -> None:
    image, knots = smooth_image(22, [2, 3, 16, 24]), 8
    for row, each in enumerate(ramp(image, knots)):
        colors = image[row].double().flatten(1).T.numpy()
        centred = colors - colors.mean(0)
        axis = np.linalg.svd(centred, full_matrices=False)[2][0]
        axis = axis if axis @ [0.299, 0.587, 0.114] > 0 else -axis
        expected = colors[np.argsort(centred @ axis)].reshape(knots, -1, 3).mean(1)
        np.testing.assert_allclose(each, expected, atol=1e-5)
