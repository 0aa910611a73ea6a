"""A scene optimised for one style: the loop that every per-scene method shares."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, get_args

import torch.nn.functional as F

from anystyle.contracts import Loss
from anystyle.losses._features import FeatureLoss
from anystyle.methods.contract import Method, Progress, silent
from anystyle.methods.scene_loop import SceneLoop, Schedule
from anystyle.perception.sources import Source
from anystyle.reconstructions.loop import fingerprint, resume, write_state
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding

Recolor = Literal["none", "before", "after", "both"]


class Optimize(Method):
    """Move Gaussians down the gradient of a sum of losses of their renders, one view a step.

    The losses are those of the configuration (``loss=[nnfm,content]``), each with its weight; presets of this method
    name theirs. Colours become those of degree 0: a view-dependent colour can be styled in each view by itself.

    Args:
        num_steps: How many.
        colors_lr: Learning rate of constant harmonics. What has a rate of 0 stays as it is, bit for bit.
        opacities_lr: Of logits of opacities.
        scales_lr: Of logarithms of scales.
        rotations_lr: Of quaternions.
        means_lr: Of centres, in mean scales of each Gaussian.
        decay: What is left of the rates at the end; they fall exponentially.
        needs_image: Whether the losses read the style's image, so that a text alone is refused.
        recolor: Whether colours take the mean and the covariance of the style's, before, after, or both.
        style_size: Shorter side in pixels that the style image is brought to; ``None`` is that of the views.
        split_every: Steps between two splits of Gaussians; 0 splits none.
        split_fraction: Of the Gaussians, those whose colours have the largest gradients are split each time.
        report_every: Steps between two reports of progress, with a thumbnail.
        state: A folder to keep optimisations in as they go, and to resume them from.
        seed: Of the order of views.

    Raises:
        ValueError: There is no loss, or a number makes no sense.
    """

    def __init__(
        self,
        *,
        losses: Mapping[str, Loss],
        num_steps: int = 200,
        colors_lr: float = 0.05,
        opacities_lr: float = 0.0,
        scales_lr: float = 0.0,
        rotations_lr: float = 0.0,
        means_lr: float = 0.0,
        decay: float = 0.1,
        needs_image: bool = True,
        recolor: Recolor = "none",
        style_size: int | None = None,
        split_every: int = 0,
        split_fraction: float = 0.05,
        report_every: int = 25,
        state: str | None = None,
        seed: int = 0,
    ) -> None:
        if not losses:
            raise ValueError("method=optimize has nothing to minimise; give loss=[nnfm,content], or a preset of it")
        if num_steps < 1 or not 0 < decay <= 1 or not 0 <= split_fraction <= 1 or report_every < 1 or split_every < 0:
            raise ValueError(
                f"method: num_steps={num_steps}, report_every={report_every}, split_every={split_every}, "
                f"decay={decay}, split_fraction={split_fraction}; steps are at least 1, decay and fractions in [0, 1]"
            )
        if recolor not in get_args(Recolor):
            raise ValueError(f"method.recolor={recolor}; choose one of {', '.join(get_args(Recolor))}")
        given = {
            "offsets": means_lr, "scales": scales_lr, "rotations": rotations_lr, "opacities": opacities_lr,
            "colors": colors_lr,
        }  # fmt: skip
        rates = {name: rate for name, rate in given.items() if rate}
        if not rates or min(rates.values()) < 0:
            raise ValueError(f"method: learning rates are {(*given.values(),)}; give one above 0, and none below")
        self.losses = dict(losses)
        self.needs_image = needs_image or recolor != "none"
        self.recolor, self.style_size = recolor, style_size
        self.schedule = Schedule(num_steps, rates, decay, split_every, split_fraction, report_every, seed)
        self.state = None if state is None else Path(state).expanduser()

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"num_steps": 3, "report_every": 1, "split_every": 2}

    @property
    def sources(self) -> tuple[Source, ...]:
        """The networks of the losses, each once."""
        known = [loss.source for loss in self.losses.values() if isinstance(loss, FeatureLoss)]
        return tuple(dict.fromkeys(known))

    def __call__(
        self,
        stylizer: Stylizer,
        scene: Scene,
        style: Style,
        embedding: StyleEmbedding,
        *,
        on_progress: Callable[[Progress], None] = silent,
    ) -> Gaussians:
        if style.image is None and self.needs_image:
            raise ValueError("this method reads a style's image, and this style has none; give --image, or method=clip")
        loop = SceneLoop(stylizer, scene, self._sized(style, scene), embedding, self.losses, self.schedule)
        if self.recolor in ("before", "both"):
            loop.recolor_before()
        path, key = None, ""
        if self.state is not None:
            words = (
                self.schedule,
                self.recolor,
                [(name, loss.weight, str(loss)) for name, loss in self.losses.items()],
            )
            given = {name: getattr(loop.before, name) for name in ("means", "harmonics")}
            key = fingerprint(words, given | {"views": loop.views.images, "style": embedding.vector})
            path = self.state / f"{key[:16]}.pt"
            resume(loop, path, key, loop.views.images.device)
        loop.run(on_progress, None if path is None else lambda: write_state(loop, path, key))
        if path is not None:
            path.unlink(missing_ok=True)
        return loop.result(recolored=self.recolor in ("after", "both"))

    def _sized(self, style: Style, scene: Scene) -> Style:
        """The style with its image as large as the views."""
        if style.image is None:
            return style
        factor = (self.style_size or min(scene.views.size)) / min(style.image.shape[-2:])
        size = [max(1, round(side * factor)) for side in style.image.shape[-2:]]
        image = F.interpolate(style.image, size=size, mode="bicubic", antialias=True, align_corners=False)
        return Style(image.clamp(0, 1).to(scene.views.images), style.text, style.has_image, style.names)
