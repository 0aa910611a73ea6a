"""The RGB-uv colour histogram of HistoGAN (Afifi et al. 2021), differentiable in the image."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

EPSILON = 1e-6


def rgb_uv_histogram(
    images: Float[Tensor, "M 3 H W"], *, bins: int = 64, width: float = 0.02, limit: int = 256
) -> Float[Tensor, "M 3 bins bins"]:
    """Intensity-weighted histograms of log-chroma, one for each colour that the two others are divided by.

    Args:
        images: sRGB; clamped to [0, 1].
        bins: On each axis, from -3 to 3.
        width: Of the inverse-quadratic kernel, in units of log-chroma.
        limit: Images with a longer side are resized to a square of this side, as published.

    Returns:
        Histograms that sum to 1 over an image.
    """
    if max(images.shape[-2:]) > limit:
        images = F.interpolate(images, size=(limit, limit), mode="bilinear", align_corners=False)
    pixels = images.clamp(0, 1).flatten(2)  # M 3 S
    intensity = (pixels.square().sum(1) + EPSILON).sqrt()  # M S
    logs = (pixels + EPSILON).log()
    centres = torch.linspace(-3, 3, bins, dtype=images.dtype, device=images.device)

    def kernel(chroma: Tensor) -> Tensor:
        return 1 / (1 + ((chroma[..., None] - centres) / width).square())  # M S bins

    planes = []
    for base, (first, second) in enumerate(((1, 2), (0, 2), (0, 1))):
        u = kernel(logs[:, base] - logs[:, first])
        v = kernel(logs[:, base] - logs[:, second])
        planes.append((intensity[..., None] * u).mT @ v)
    histogram = torch.stack(planes, dim=1)
    return histogram / (histogram.sum((1, 2, 3), keepdim=True) + EPSILON)


def hellinger(first: Float[Tensor, "M 3 b b"], second: Float[Tensor, "M 3 b b"]) -> Float[Tensor, " M"]:
    """Hellinger distance of histograms that sum to 1, in [0, 1]."""
    # The square root has no finite gradient at 0, where a bin is empty.
    tiny = torch.finfo(first.dtype).tiny
    difference = first.clamp_min(tiny).sqrt() - second.clamp_min(tiny).sqrt()
    return difference.flatten(1).norm(dim=-1) / 2**0.5
