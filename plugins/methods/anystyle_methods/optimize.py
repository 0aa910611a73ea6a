"""Optimisation of one scene for one style, the basis of every per-scene method."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import torch.nn.functional as F

from anystyle.contracts import Loss, Method
from anystyle.errors import UserError
from anystyle.losses.features import FeatureLoss
from anystyle.ranges import AtLeastOne, NonNegative, Share
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Source, Style, StyleEmbedding
from anystyle.types.progress import OnProgress, no_progress
from anystyle_methods.scene_loop import SceneLoop


class Optimize(Method):
    """Optimise Gaussians by gradient descent on a weighted sum of losses of their renders, one view per step.

    The losses are those of the configuration (``loss=[nnfm,content]``), each with its weight; presets of this method
    name theirs. Colours are reduced to degree 0, because view-dependent ones could fit each view separately.

    Args:
        num_steps: Optimisation steps.
        colors_lr: Learning rate of constant harmonics. Parameters with a rate of 0 are not changed by one bit.
        opacities_lr: Learning rate of the logits of opacities.
        scales_lr: Learning rate of the logarithms of scales.
        rotations_lr: Learning rate of quaternions.
        means_lr: Learning rate of centres, in units of each Gaussian's mean scale.
        decay: Final rates as a fraction of the initial ones; the decay is exponential.
        needs_image: Whether the losses need the style's image, so that a text without an image is refused.
        recolor: Whether to match the mean and the covariance of colours to the style's, before, after, or both.
        style_size: Shorter side in pixels that the style image is resized to; ``None`` is that of the views.
        report_every: Steps between two reports of progress, with a thumbnail.
        keep_harmonics: Whether to keep harmonics above degree 0; they are dropped otherwise.
        seed: Seed of the order of views.
    """

    def __init__(
        self,
        *,
        losses: Mapping[str, Loss],
        num_steps: AtLeastOne = 200,
        colors_lr: NonNegative = 0.05,
        opacities_lr: NonNegative = 0.0,
        scales_lr: NonNegative = 0.0,
        rotations_lr: NonNegative = 0.0,
        means_lr: NonNegative = 0.0,
        decay: Share = 0.1,
        needs_image: bool = True,
        recolor: Literal["none", "before", "after", "both"] = "none",
        style_size: AtLeastOne | None = None,
        report_every: AtLeastOne = 25,
        keep_harmonics: bool = False,
        seed: int = 0,
    ) -> None:
        if not losses:
            raise UserError("method=optimize has no loss to minimise; give loss=[nnfm,content], or a preset of it")
        given = {
            "offsets": means_lr, "scales": scales_lr, "rotations": rotations_lr, "opacities": opacities_lr,
            "colors": colors_lr,
        }  # fmt: skip
        rates = {name: rate for name, rate in given.items() if rate}
        if not rates:
            raise UserError("method: all learning rates are 0; give one above 0, such as method.colors_lr=0.05")
        self.losses = dict(losses)
        self.needs_image = needs_image or recolor != "none"
        self.recolor, self.style_size = recolor, style_size
        self.num_steps, self.report_every = num_steps, report_every
        self.schedule: dict[str, Any] = {
            "rates": rates, "decay": decay, "seed": seed, "keep_harmonics": keep_harmonics,
        }  # fmt: skip

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"num_steps": 3, "report_every": 1}

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks of the losses, each once."""
        return tuple(dict.fromkeys(loss.source for loss in self.losses.values() if isinstance(loss, FeatureLoss)))

    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: OnProgress = no_progress,
    ) -> Gaussians:
        if style.image is None and self.needs_image:
            raise UserError("this method needs a style image, and this style has none; give --image, or method=clip")
        loop = SceneLoop(stylizer, scene, self._sized(style, scene), embedding, self.losses, **self.schedule)
        if self.recolor in ("before", "both"):
            loop.recolor_before()
        loop.run(self.num_steps, self.report_every, on_progress)
        return loop.result(recolored=self.recolor in ("after", "both"))

    def _sized(self, style: Style, scene: Scene) -> Style:
        """The style with its image resized as ``style_size`` says."""
        if style.image is None:
            return style
        factor = (self.style_size or min(scene.views.size)) / min(style.image.shape[-2:])
        size = [max(1, round(side * factor)) for side in style.image.shape[-2:]]
        image = F.interpolate(style.image, size=size, mode="bicubic", antialias=True, align_corners=False)
        return Style(image.clamp(0, 1).to(scene.views.images), style.text, style.has_image, style.names)
