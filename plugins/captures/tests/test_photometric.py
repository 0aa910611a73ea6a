"""The photometric loss, against the metric and automatic differentiation."""

import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity
from torch.nn.functional import conv2d

from anystyle_captures.photometric import blur, match_colors, photometric_loss, quality_of, unexplained


def pair(height=40, width=33, batch=2):
    generator = torch.Generator().manual_seed(0)
    first = torch.rand(batch, 3, height, width, generator=generator)
    return first, (first + 0.2 * torch.randn(first.shape, generator=generator)).clamp(0, 1)


def plain_blur(planes):
    kernel = (-0.5 * (torch.arange(-5, 6, dtype=planes.dtype) / 1.5).square()).exp()
    kernel = (kernel / kernel.sum())[:, None] * (kernel / kernel.sum())
    return conv2d(planes[:, None], kernel[None, None], padding=5)[:, 0]


def plain_loss(first, second, dssim):
    """The loss of 3D Gaussian splatting, SSIM of grey values, differentiated by PyTorch."""
    gray, other = first.mean(1), second.mean(1)
    a, b, aa, bb, ab = (plain_blur(x) for x in (gray, other, gray**2, other**2, gray * other))
    top = (2 * a * b + 0.01**2) * (2 * (ab - a * b) + 0.03**2)
    similarity = top / ((a**2 + b**2 + 0.01**2) * (aa - a**2 + bb - b**2 + 0.03**2))
    return (1 - dssim) * (first - second).abs().mean() + dssim * (1 - similarity.mean())


def test_blur_is_a_convolution():
    planes = pair()[0].flatten(0, 1)
    for given in (planes, planes[:, :4, :3]):
        torch.testing.assert_close(blur(given), plain_blur(given), rtol=1e-5, atol=1e-6)


def test_quality_agrees_with_another_library():
    first, second = pair()
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0}
    arrays = list(zip(first.double().numpy(), second.double().numpy(), strict=True))
    expected = [structural_similarity(*pair, channel_axis=0, **options) for pair in arrays]
    quality = quality_of(first, second)
    assert quality.ssim == pytest.approx(sum(expected) / 2, abs=1e-5)
    decibels = [peak_signal_noise_ratio(*pair, data_range=1.0) for pair in arrays]
    assert quality.psnr == pytest.approx(sum(decibels) / 2, abs=1e-4) and quality.matched_psnr > quality.psnr


def test_the_gradient_is_that_of_automatic_differentiation():
    first, second = pair()
    exact = first.double().requires_grad_()
    expected = torch.autograd.grad(plain_loss(exact, second.double(), 0.3), exact)[0]
    leaf = first.clone().requires_grad_()
    loss = photometric_loss(leaf, second, dssim=0.3)
    torch.testing.assert_close(loss.double(), plain_loss(exact, second.double(), 0.3), rtol=1e-5, atol=1e-6)
    assert (torch.autograd.grad(loss, leaf)[0].double() - expected).norm() < 1e-4 * expected.norm()


def test_colors_are_matched_in_the_dark():
    """An affine change of colours is undone, and what is left is what least squares in double precision leaves."""
    generator = torch.Generator().manual_seed(3)
    image = 0.02 * torch.rand(3, 40, 50, generator=generator)
    change = torch.tensor([[0.9, 0.1, 0.0], [0.0, 1.1, -0.1], [0.05, 0.0, 0.8]])
    target = torch.einsum("ij,jhw->ihw", change, image) + 0.003
    torch.testing.assert_close(match_colors(image, target), target, rtol=0, atol=1e-6)
    noisy = target + 0.001 * torch.randn(target.shape, generator=generator)
    assert (match_colors(image, noisy) - noisy).square().mean() <= (target - noisy).square().mean()


def test_a_patch_that_differs_is_unexplained_and_fine_texture_is_not():
    """Within the width of a window around it; what differs by single pixels does not count."""
    images = torch.full((3, 3, 96, 96), 0.5)
    targets = images.clone()
    targets[1, :, 20:60, 30:70] = 0.9
    targets[2, :, ::4, ::4] = 1.0
    share = unexplained(images, targets)
    assert share[0] == 0 and share[2] == 0 and 38**2 <= float(share[1]) * 96**2 <= 44**2
