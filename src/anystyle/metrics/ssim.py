"""SSIM: how much of the photographs' structure is in stylized images."""

from collections.abc import Mapping
from typing import ClassVar

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import Pairs, gathered
from anystyle.types import Comparison

RADIUS, SIGMA = 5, 1.5
"""The published window: a Gaussian of 11 x 11 pixels."""
C1, C2 = 0.01**2, 0.03**2


class SSIM(RowMean):
    """Structural similarity of reconstructions (Wang et al. 2004) with the published Gaussian window, in [-1, 1].

    Each channel by itself, averaged over those places whose window lies inside of the image.
    """

    better: ClassVar[Mapping[str, str]] = {"ssim": "higher"}
    higher_is_better = True

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views."""
        return gathered(comparison, structural_similarity)


def structural_similarity(some: Pairs) -> Float[Tensor, " M"]:
    """SSIM of each pair.

    Raises:
        ValueError: The images are smaller than the window.
    """
    first, second = some.stylized.double(), some.content.double()
    if min(first.shape[-2:]) < 2 * RADIUS + 1:
        height, width = first.shape[-2:]
        raise ValueError(f"ssim got images of {height}x{width} pixels; its window needs {2 * RADIUS + 1}: enlarge them")
    mean_a, mean_b = _blur(first), _blur(second)
    var_a = _blur(first.square()) - mean_a.square()
    var_b = _blur(second.square()) - mean_b.square()
    both = _blur(first * second) - mean_a * mean_b
    brightness = (2 * mean_a * mean_b + C1) / (mean_a.square() + mean_b.square() + C1)
    structure = (2 * both + C2) / (var_a + var_b + C2)
    return (brightness * structure).mean((1, 2, 3))


def _blur(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 h w"]:
    steps = torch.arange(-RADIUS, RADIUS + 1, dtype=images.dtype, device=images.device)
    kernel = (-0.5 * (steps / SIGMA).square()).exp()
    kernel = (kernel / kernel.sum()).view(1, 1, 1, -1).expand(3, -1, -1, -1)
    return F.conv2d(F.conv2d(images, kernel, groups=3), kernel.mT, groups=3)
