"""The single pass."""

import torch

from anystyle.errors import UserError
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.base import Method
from anystyle.methods.colors import fit_colors
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress


class Branch(Method):
    """What the style branch predicts in a single pass, as in the paper.

    Fitted or given Gaussians, which the branch knows nothing of, are coloured so that their renders look like the
    styled pixels; everything else of them stays as it is.

    Args:
        fit_colors: Steps of least squares for the colours of such Gaussians, in which each surface is coloured by the
            view that shows it largest; 0 takes the mean of the pixels that show a Gaussian there.
        keep_harmonics: Whether such Gaussians keep their harmonics above degree 0; they are dropped otherwise.
    """

    def __init__(self, *, fit_colors: int = 4, keep_harmonics: bool = False) -> None:
        if fit_colors < 0:
            raise UserError(f"method.fit_colors={fit_colors}; give a number of steps, 0 or more")
        self.fit_colors, self.keep_harmonics = fit_colors, keep_harmonics

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
        with torch.enable_grad():
            colored = fit_colors(
                scene.gaussians, scene.cameras, targets, stylizer.renderer, steps=self.fit_colors, largest=True,
                keep=self.keep_harmonics,
            )  # fmt: skip
        return colored.detach()
