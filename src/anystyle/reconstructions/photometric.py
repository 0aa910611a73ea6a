"""How far renders are from photographs: L1 and structural dissimilarity, with a gradient written by hand."""

from functools import partial
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import avg_pool2d, conv2d

from anystyle import compiled as compilation

RADIUS, SIGMA = 5, 1.5
"""The published window of SSIM (Wang et al. 2004): a Gaussian of 11 x 11 pixels."""
C1, C2 = 0.01**2, 0.03**2

LARGE = 0.15
"""A difference of colours, in [0, 1], that neither noise nor exposure makes."""

Array = np.ndarray

compiled = partial(compilation.compiled, fastmath=compilation.CONTRACT)


def photometric_loss(
    images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"], *, dssim: float
) -> Float[Tensor, ""]:
    """The loss of 3D Gaussian splatting: ``(1 - dssim) L1 + dssim (1 - SSIM)``, differentiable in ``images``."""
    return (1 - dssim) * (images - targets).abs().mean() + dssim * _Dissimilarity.apply(images, targets)


def ssim(images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
    """Structural similarity of each pair, over those pixels whose window lies inside of the image."""
    similarity, _ = _similarity(images, targets)
    return similarity[..., RADIUS:-RADIUS, RADIUS:-RADIUS].mean((1, 2, 3))


def psnr(images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
    """Peak signal-to-noise ratio of each pair in dB, of values in [0, 1]."""
    return -10 * (images - targets).square().mean((1, 2, 3)).clamp_min(1e-12).log10()


def match_colors(image: Float[Tensor, "3 H W"], target: Float[Tensor, "3 H W"]) -> Float[Tensor, "3 H W"]:
    """An image after the affine change of its colours that brings it nearest to a target in squared error."""
    # In double precision: the solver loses several dB of a dark image in single.
    colors = torch.cat([image.flatten(1), torch.ones_like(image[:1]).flatten(1)]).T.double()  # (H W) 4
    change = torch.linalg.lstsq(colors, target.flatten(1).T.double()).solution
    return (colors @ change).T.view_as(image).to(image.dtype)


def unexplained(images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"]) -> Float[Tensor, " M"]:
    """The share of each pair's pixels around which it differs by more than :data:`LARGE`, on average over a window.

    Windows span 1/24 of the shorter side, so that a sharp edge that is slightly off does not count.
    """
    side = max(3, min(images.shape[-2:]) // 24) | 1
    error = (images - targets).abs().mean(1, keepdim=True)
    return (avg_pool2d(error, side, 1, side // 2) > LARGE).float().mean((1, 2, 3))


class _Dissimilarity(torch.autograd.Function):
    """1 - SSIM averaged over all pixels, as in 3D Gaussian splatting: images are zero behind their borders."""

    @staticmethod
    def forward(ctx: Any, first: Tensor, second: Tensor) -> Tensor:  # pyright: ignore[reportIncompatibleMethodOverride]
        similarity, derivatives = _similarity(first, second)
        # The window is symmetric, so that its blur is its own adjoint.
        by_a, by_aa, by_ab = blur(derivatives.flatten(0, 2)).view_as(derivatives)
        gradient = torch.addcmul(by_a, second, by_ab).addcmul_(first, by_aa, value=2)
        ctx.save_for_backward(gradient.mul_(-1 / first.numel()))
        return 1 - similarity.mean()

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad_output: Tensor) -> tuple[Tensor, None]:  # pyright: ignore[reportIncompatibleMethodOverride]
        return grad_output * ctx.saved_tensors[0], None


def _similarity(
    first: Float[Tensor, "M 3 H W"], second: Float[Tensor, "M 3 H W"]
) -> tuple[Float[Tensor, "M 3 H W"], Float[Tensor, "3 M 3 H W"]]:
    """SSIM of every pixel, and its derivatives by the blurred ``a``, ``a²`` and ``ab``, of images ``a`` and ``b``."""
    moments = torch.stack([first, second, first * first, second * second, first * second])
    moments = blur(moments.flatten(0, 2)).view_as(moments)
    similarity, derivatives = torch.empty_like(first), first.new_empty(3, *first.shape)
    if first.device.type == "cpu" and first.dtype == torch.float32:
        _compare(moments.flatten(1).numpy(), similarity.view(-1).numpy(), derivatives.flatten(1).numpy())
        return similarity, derivatives
    a, b, aa, bb, ab = moments
    light, structure = 2 * a * b + C1, 2 * (ab - a * b) + C2
    light_scale, structure_scale = a * a + b * b + C1, aa - a * a + bb - b * b + C2
    scale = light_scale * structure_scale
    similarity = light * structure / scale
    by_a = 2 * (b * (structure - light) / scale + a * similarity * (1 / structure_scale - 1 / light_scale))
    return similarity, torch.stack([by_a, -similarity / structure_scale, 2 * light / scale])


def blur(planes: Float[Tensor, "P H W"]) -> Float[Tensor, "P H W"]:
    """Convolve planes with SSIM's window; they are zero behind their borders."""
    steps = torch.arange(-RADIUS, RADIUS + 1, dtype=planes.dtype, device=planes.device)
    window = (-0.5 * (steps / SIGMA).square()).exp()
    window /= window.sum()
    if planes.device.type == "cpu" and planes.dtype == torch.float32:
        blurred = torch.empty_like(planes, memory_format=torch.contiguous_format)
        _blur(planes.detach().contiguous().numpy(), window.numpy(), blurred.numpy())
        return blurred
    rows = conv2d(planes[:, None], window.view(1, 1, 1, -1), padding=(0, RADIUS))
    return conv2d(rows, window.view(1, 1, -1, 1), padding=(RADIUS, 0))[:, 0]


@compiled
def _blur(planes: Array, window: Array, blurred: Array) -> None:
    """Write planes ``[P, H, W]`` convolved with a symmetric window of 11 in both directions.

    Taps are written out, so that a row is one loop of vector instructions that stores once.
    """
    num_planes, height, width = planes.shape
    w0, w1, w2, w3, w4, w5 = window[5], window[4], window[3], window[2], window[1], window[0]
    tall = np.zeros((height + 10, width), np.float32)
    row = np.zeros(width + 10, np.float32)
    for p in range(num_planes):
        for y in range(height):
            for x in range(width):
                tall[y + 5, x] = planes[p, y, x]
        for y in range(height):
            for x in range(width):
                value = w0 * tall[y + 5, x] + w1 * (tall[y + 4, x] + tall[y + 6, x])
                value += w2 * (tall[y + 3, x] + tall[y + 7, x]) + w3 * (tall[y + 2, x] + tall[y + 8, x])
                row[x + 5] = value + w4 * (tall[y + 1, x] + tall[y + 9, x]) + w5 * (tall[y, x] + tall[y + 10, x])
            for x in range(width):
                value = w0 * row[x + 5] + w1 * (row[x + 4] + row[x + 6])
                value += w2 * (row[x + 3] + row[x + 7]) + w3 * (row[x + 2] + row[x + 8])
                blurred[p, y, x] = value + w4 * (row[x + 1] + row[x + 9]) + w5 * (row[x] + row[x + 10])


@compiled
def _compare(moments: Array, similarity: Array, derivatives: Array) -> None:
    """Write SSIM ``[n]`` and its derivatives ``[3, n]`` from blurred moments ``[5, n]``; see :func:`_similarity`."""
    one, two, c1, c2 = np.float32(1), np.float32(2), np.float32(C1), np.float32(C2)
    for i in range(similarity.shape[0]):
        a, b = moments[0, i], moments[1, i]
        light, structure = two * a * b + c1, two * (moments[4, i] - a * b) + c2
        light_scale = a * a + b * b + c1
        structure_scale = moments[2, i] - a * a + moments[3, i] - b * b + c2
        scale = one / (light_scale * structure_scale)
        value = light * structure * scale
        similarity[i] = value
        derivatives[0, i] = two * scale * (b * (structure - light) + a * value * (light_scale - structure_scale))
        derivatives[1, i] = -value * scale * light_scale
        derivatives[2, i] = two * light * scale
