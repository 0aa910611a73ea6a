"""The loss of a fit, compiled with its gradient, and how far renders are from photographs."""

from functools import partial
from typing import Any, NamedTuple

import kornia
import numpy as np
import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.autograd.function import once_differentiable
from torch.nn.functional import avg_pool2d, conv2d, max_pool2d

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
    """The loss of 3D Gaussian splatting, ``(1 - dssim) L1 + dssim (1 - SSIM)``, differentiable in ``images``.

    SSIM is of grey values, at a third of the cost.
    """
    loss = _Photometric.apply(images, targets, dssim)
    assert isinstance(loss, Tensor)
    return loss


class Quality(NamedTuple):
    """How close renders are to photographs; means over the views."""

    psnr: float
    ssim: float
    matched_psnr: float


def quality_of(
    renders: Float[Tensor, "M 3 H W"],
    photographs: Float[Tensor, "M 3 H W"],
    measured: Bool[Tensor, "M H W"] | None = None,
) -> Quality:
    """Compare renders with photographs, both in [0, 1], at the pixels that are measured, at least one of each."""
    if measured is None:
        measured = torch.ones_like(renders[:, 0], dtype=torch.bool)
    matched = torch.stack([match_colors(*given) for given in zip(renders, photographs, measured, strict=True)])
    renders = torch.where(measured[:, None], renders, photographs)
    similarity = kornia.metrics.ssim(renders, photographs, 2 * RADIUS + 1, eps=0.0, padding="valid").mean(1)  # M h w
    inner = measured[:, RADIUS:-RADIUS, RADIUS:-RADIUS]
    ssim = float((similarity * inner).sum() / inner.sum().clamp_min(1))
    return Quality(
        float(psnr(renders, photographs, measured).mean()), ssim, float(psnr(matched, photographs, measured).mean())
    )


def psnr(
    images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"], measured: Bool[Tensor, "M H W"]
) -> Float[Tensor, " M"]:
    """Peak signal-to-noise ratios in dB, at most 120, at the pixels that are measured."""
    error = (images - targets).square().mean(1) * measured
    return (-10 * (error.sum((1, 2)) / measured.sum((1, 2)).clamp_min(1)).log10()).clamp_max(120)


def match_colors(
    image: Float[Tensor, "3 H W"], target: Float[Tensor, "3 H W"], measured: Bool[Tensor, "H W"] | None = None
) -> Float[Tensor, "3 H W"]:
    """An image after the affine change of its colours that brings it nearest to a target in squared error."""
    # In double precision: the solver loses several dB of a dark image in single.
    colors = torch.cat([image.flatten(1), torch.ones_like(image[:1]).flatten(1)]).T.double()  # (H W) 4
    known = slice(None) if measured is None else measured.flatten()
    change = torch.linalg.lstsq(colors[known], target.flatten(1).T.double()[known]).solution
    return (colors @ change).T.view_as(image).to(image.dtype)


def unexplained(
    images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"], measured: Bool[Tensor, "M H W"] | None = None
) -> Float[Tensor, " M"]:
    """The share of each pair's pixels around which it differs by more than :data:`LARGE`, on average over a window.

    Windows span 1/24 of the shorter side, so that a sharp edge that is slightly off does not count.
    """
    error = (images - targets).abs().mean(1, keepdim=True)
    measured = torch.ones_like(error, dtype=torch.bool) if measured is None else measured[:, None]
    large = _mean_around(error * measured) > LARGE
    return (large & measured).sum((1, 2, 3)) / measured.sum((1, 2, 3)).clamp_min(1)


def unlike(images: Float[Tensor, "M 3 H W"], targets: Float[Tensor, "M 3 H W"]) -> Bool[Tensor, "M H W"]:
    """The pixels of whole windows around which pairs differ so, which hold what differs to its border."""
    large = _mean_around((images - targets).abs().mean(1)) > LARGE
    return max_pool2d(large.float(), side := _window(images), 1, side // 2) > 0


def _mean_around(values: Float[Tensor, "*batch H W"]) -> Float[Tensor, "*batch H W"]:
    """The mean over the window around each pixel, zero behind the borders."""
    side = _window(values)
    return avg_pool2d(avg_pool2d(values, (side, 1), 1, (side // 2, 0)), (1, side), 1, (0, side // 2))


def _window(images: Float[Tensor, "*batch H W"]) -> int:
    return max(3, min(images.shape[-2:]) // 24) | 1


class _Photometric(torch.autograd.Function):
    """SSIM is averaged over all pixels, as in 3D Gaussian splatting: images are zero behind their borders."""

    @staticmethod
    def forward(ctx: Any, *inputs: Any) -> Tensor:
        images, targets, dssim = inputs
        first, second = images.mean(1), targets.mean(1)
        # Of the variances SSIM takes the sum alone.
        moments = torch.stack([first, second, first * first + second * second, first * second])
        a, b, squares, ab = blur(moments.flatten(0, 1)).view_as(moments)
        light, structure, light_scale = 2 * a * b + C1, 2 * (ab - a * b) + C2, a * a + b * b + C1
        structure_scale = squares - light_scale + (C1 + C2)
        scale = light_scale * structure_scale
        similarity = light * structure / scale
        by_a = 2 * (b * (structure - light) / scale + a * similarity * (1 / structure_scale - 1 / light_scale))
        derivatives = torch.stack([by_a, -similarity / structure_scale, 2 * light / scale])
        # The window is symmetric, so that its blur is its own adjoint.
        by_a, by_squares, by_ab = blur(derivatives.flatten(0, 1)).view_as(derivatives)
        by_gray = by_a.addcmul_(second, by_ab).addcmul_(first, by_squares, value=2)
        difference = images - targets
        loss = (1 - dssim) * difference.abs().mean() + dssim * (1 - similarity.mean())
        ctx.save_for_backward(difference.sgn_().mul_(1 - dssim).sub_(dssim * by_gray[:, None]))
        return loss

    @staticmethod
    @once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, grad_output: Tensor
    ) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return gradient * (grad_output / gradient.numel()), None, None


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
    """Write planes ``[P, H, W]`` convolved with a symmetric window of 11; each row is one vectorised loop."""
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
