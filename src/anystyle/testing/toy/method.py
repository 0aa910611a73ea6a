"""A tint: the smallest method."""

from dataclasses import replace

import torch

from anystyle.contracts import Method
from anystyle.geometry.harmonics import constant_from_rgb, rgb_from_constant
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding
from anystyle.types.progress import OnProgress, no_progress


class ToyMethod(Method):
    """Mix the mean colour of the style's image into that of every Gaussian; a style without one changes nothing.

    Args:
        amount: How much of the style's colour, in [0, 1].
    """

    def __init__(self, *, amount: float = 0.5) -> None:
        self.amount = amount

    @torch.no_grad()
    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        gaussians = stylizer.unstyled(scene)
        if style.image is None:
            return gaussians
        tint = style.image.mean((0, 2, 3))  # 3
        colors = torch.lerp(rgb_from_constant(gaussians.harmonics[:, :, :1]), tint, self.amount)
        return replace(gaussians, harmonics=constant_from_rgb(colors))
