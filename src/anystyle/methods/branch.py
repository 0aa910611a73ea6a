"""The single pass."""

from dataclasses import replace

import torch

from anystyle.errors import UserError
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.base import Method
from anystyle.methods.colors import colors_alone, fit_colors, largest_shown
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress

MAX_VIEWS = 48
"""Views that fitted Gaussians are coloured by, where the branch paints each alone; of more, those farthest apart."""


class Branch(Method):
    """What the style branch predicts in a single pass, as in the paper.

    Fitted or given Gaussians, which the branch knows nothing of, are coloured so that their renders look like the
    styled pixels; everything else of them stays as it is.

    Args:
        fit_colors: Steps of least squares for the colours of such Gaussians, in which each surface is coloured by the
            view that shows it largest; 0 takes the mean of the pixels that show a Gaussian there.
        refine_strokes: Steps of gradient descent that then move, turn and stretch such Gaussians so that they show
            painted strokes, one view a step; 0 keeps their geometry.
        keep_harmonics: Whether such Gaussians keep their harmonics above degree 0; they are dropped otherwise.
    """

    def __init__(self, *, fit_colors: int = 4, refine_strokes: int = 0, keep_harmonics: bool = False) -> None:
        if fit_colors < 0 or refine_strokes < 0:
            raise UserError(f"method: {fit_colors=} {refine_strokes=}; give numbers of steps, 0 or more")
        self.fit_colors, self.refine_strokes, self.keep_harmonics = fit_colors, refine_strokes, keep_harmonics

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
        gaussians = scene.gaussians
        if gaussians is None:
            return stylizer.restyle(scene, embedding)
        if scene.views.images.shape[1] > MAX_VIEWS and stylizer.branch.gaussian_head is None:
            scene = _thinned(scene, MAX_VIEWS)
        color = stylizer.branch(scene, embedding).color[0]  # V H W 3 K
        targets = rgb_from_constant(color[..., 0]).clamp(0, 1).movedim(-1, 1).float()  # V 3 H W
        with torch.enable_grad():
            colored = fit_colors(
                gaussians, scene.cameras, targets, stylizer.renderer, steps=self.fit_colors, largest=True,
                keep=self.keep_harmonics,
            ).detach()  # fmt: skip
            if self.refine_strokes:
                from anystyle.methods.refine import refine

                confidence = largest_shown(gaussians, scene.cameras, stylizer.renderer)
                colored = refine(
                    colored, scene.cameras, targets, confidence, stylizer.renderer, steps=self.refine_strokes
                )
        return colored


def _thinned(scene: Scene, count: int) -> Scene:
    """A scene of colours alone with those of its views whose cameras lie farthest apart, each in turn."""
    centers = scene.cameras.world_from_camera[0, :, :3, 3]
    chosen = [0]
    distances = (centers - centers[0]).norm(dim=-1)
    while len(chosen) < count:
        chosen.append(int(distances.argmax()))
        distances = distances.minimum((centers - centers[chosen[-1]]).norm(dim=-1))
    chosen.sort()
    thinned = colors_alone(replace(scene.views.select(chosen), cameras=scene.cameras.select(chosen)))
    attributes = replace(thinned.attributes, color=scene.attributes.color[:, chosen])
    return replace(thinned, attributes=attributes, gaussians=scene.gaussians)
