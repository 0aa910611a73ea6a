"""The single pass."""

from typing import Literal

import torch

from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.base import Method
from anystyle.methods.colors import FitColors, checked_steps, color_gaussians
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress


class Branch(Method):
    """What the style branch predicts in a single pass, as in the paper.

    Fitted or given Gaussians, which the branch knows nothing of, are coloured so that their renders look like the
    styled pixels; everything else of them stays as it is.

    Args:
        fit_colors: For such Gaussians: ``off`` takes the colour of the pixel that each was made from, ``mean`` the mean
            of all pixels that show it, a number so many steps of least squares, in which each surface is coloured by
            the view that shows it largest.
        keep_harmonics: Whether such Gaussians keep their harmonics above degree 0; they are dropped otherwise.

    Raises:
        UserError: ``fit_colors`` is none of these.
    """

    def __init__(self, *, fit_colors: int | Literal["off", "mean"] = 6, keep_harmonics: bool = False) -> None:
        self.fit_colors: FitColors = checked_steps(fit_colors)
        self.keep_harmonics = keep_harmonics

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
        if scene.gaussians is None:
            return stylizer.restyle(scene, embedding)
        color = stylizer.branch(scene, embedding).color[0]  # V H W 3 K
        targets = rgb_from_constant(color[..., 0]).clamp(0, 1).movedim(-1, 1).float()  # V 3 H W
        origins = None if scene.origins is None else scene.origins[0]
        with torch.enable_grad():
            colored = color_gaussians(
                scene.gaussians,
                scene.cameras,
                targets,
                stylizer.renderer,
                origins,
                self.fit_colors,
                keep=self.keep_harmonics,
            )
        return colored.detach()
