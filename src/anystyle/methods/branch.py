"""The method of the paper: the style branch in a single pass."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Method
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.methods.colors import colors_alone, covering_views, fit_colors, largest_shown
from anystyle.ranges import Count, Share
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, OnProgress, Scene, Style, StyleEmbedding, no_progress

COVERAGE = 0.95
"""Of fitted Gaussians, by the views that are painted; see :class:`Branch`."""
MAX_VIEWS = 48
"""By which fitted Gaussians are coloured, where the branch paints each view separately."""


class Branch(Method):
    """What the style branch predicts in a single pass, as in the paper.

    Fitted or given Gaussians, which the branch does not predict, are coloured so that their renders look like the
    styled pixels; everything else of them stays as it is.

    Args:
        fit_colors: Steps of least squares for the colours of such Gaussians, in which each surface is coloured by the
            view that shows it largest; 0 takes the mean of the pixels that show a Gaussian there.
        coverage: Fraction of such Gaussians that the painted views must show, each at half its largest size or more, in
            (0, 1]; the fewest such views are painted. Where the branch sees views together, all of them are.
        refine_strokes: Steps of gradient descent that then move, turn and stretch such Gaussians so that they show
            painted strokes, one view per step; 0 keeps their geometry.
        keep_harmonics: Whether such Gaussians keep their harmonics above degree 0; they are dropped otherwise.
    """

    def __init__(
        self,
        *,
        fit_colors: Count = 4,
        coverage: Share = COVERAGE,
        refine_strokes: Count = 0,
        keep_harmonics: bool = False,
    ) -> None:
        self.fit_colors, self.coverage = fit_colors, coverage
        self.refine_strokes, self.keep_harmonics = refine_strokes, keep_harmonics

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
        scene, targets = painted(stylizer, scene, embedding, coverage=self.coverage)
        with torch.enable_grad():
            colored = fit_colors(
                gaussians, scene.cameras, targets, stylizer.renderer, steps=self.fit_colors, largest=True,
                keep=self.keep_harmonics, alpha=None if scene.views.alpha is None else scene.views.alpha[0],
            ).detach()  # fmt: skip
            if self.refine_strokes:
                from anystyle.methods.refine import refine

                confidence = largest_shown(gaussians, scene.cameras, stylizer.renderer)
                colored = refine(
                    colored, scene.cameras, targets, confidence, stylizer.renderer, steps=self.refine_strokes
                )
        return colored


def painted(
    stylizer: Stylizer, scene: Scene, embedding: StyleEmbedding, *, coverage: float = COVERAGE
) -> tuple[Scene, Float[Tensor, "V 3 H W"]]:
    """What the branch paints on views of a scene: sRGB in [0, 1], of a batch of one.

    Args:
        stylizer: Its style branch paints.
        scene: A batch of one.
        embedding: The style.
        coverage: See :class:`Branch`; of Gaussians that are fitted or given.

    Returns:
        The scene with the views that are painted, and their colours.
    """
    if scene.gaussians is not None and stylizer.branch.gaussian_head is None:
        with torch.enable_grad():
            views = covering_views(scene.gaussians, scene.cameras, stylizer.renderer, share=coverage, most=MAX_VIEWS)
        chosen, color = replace(scene.views, cameras=scene.cameras).select(views), scene.attributes.color[:, views]
        scene = replace(colors_alone(chosen, color), gaussians=scene.gaussians)
    color = stylizer.branch(scene, embedding).color[0]  # V H W 3 K
    return scene, rgb_from_constant(color[..., 0]).clamp_(0, 1).movedim(-1, 1).float()
