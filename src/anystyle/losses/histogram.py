"""Histogram: match the colours of the style image."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.losses._features import mean_where, style_images
from anystyle.types import Stylization
from anystyle.vision.statistics import hellinger, rgb_uv_histogram


class Histogram(Loss):
    """Match the RGB-uv histogram of the style image (HistoGAN, Afifi et al. 2021, equations 1 to 4).

    Hellinger distance of the differentiable histograms, averaged over views whose style has an image.

    Args:
        bins: On each axis of log-chroma.
        width: Of the kernel; the published 0.02 of the colour-matching metric is finer than a bin.
        weight: In the objective.
    """

    def __init__(self, *, bins: int = 64, width: float = 0.02, weight: float = 1.0) -> None:
        super().__init__()
        self.bins, self.width, self.weight = bins, width, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        styles = style_images(result)
        color = result.renders.color
        if styles is None:
            return color.new_zeros(())
        image, given = styles
        with torch.no_grad():
            target = rgb_uv_histogram(image, bins=self.bins, width=self.width)
        histogram = rgb_uv_histogram(color.flatten(0, 1), bins=self.bins, width=self.width)
        distances = hellinger(histogram, target.repeat_interleave(color.shape[1], 0))
        return mean_where(distances, given.repeat_interleave(color.shape[1]))
