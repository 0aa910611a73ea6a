"""Distillation: views as the style transfer network paints them in 2D."""

from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.losses.features import mean_where
from anystyle.types import Stylization
from anystyle.vision.features import Frozen, freeze
from anystyle_magenta.injector import stylize_images
from anystyle_magenta.networks import StylePrediction, StyleTransfer
from anystyle_magenta.pretrained import load_prediction, load_transfer
from anystyle_magenta.style_encoder import centre_square


class Painter(Frozen):
    """Magenta's two networks with their published weights."""

    def __init__(self) -> None:
        super().__init__()
        self.prediction, self.transfer = StylePrediction(), StyleTransfer()
        load_prediction(self.prediction)
        load_transfer(self.transfer)


class Teacher(Loss):
    """Come near the photographs as Magenta's networks stylize them: ``mean |I - T| + edges * mean |dI - dT|``.

    ``T`` are the photographs of a scene, stylized together by the style image, ``d`` differences of neighbouring
    pixels, down and across. Styles without an image add nothing.

    Args:
        working_size: Shorter side in pixels at which the teacher sees the photographs.
        edges: The factor above.
        weight: In the objective.

    Example:
        >>> result, loss = inputs.stylization(), Teacher(working_size=32)
        >>> painted = loss.stylized(result.views.images, result.style.image)
        >>> renders = replace(result.renders, color=painted + 0.25)  # everywhere brighter, with the same edges
        >>> print(f"{loss(replace(result, renders=renders)):.2f}")
        0.25
    """

    def __init__(self, *, working_size: int = 224, edges: float = 1.0, weight: float = 10.0) -> None:
        super().__init__()
        self.painter = freeze(Painter().eval())
        self.working_size, self.edges, self.weight = working_size, edges, weight

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"working_size": 32}

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        renders, image, given = result.renders.color, result.style.image, result.style.has_image
        if image is None:
            return renders.new_zeros(())
        target = self.stylized(result.views.images, image)
        distance = _difference(renders, target)
        for axis in (-1, -2):
            distance = distance + self.edges * _difference(renders.diff(dim=axis), target.diff(dim=axis))
        return distance.mean() if given is None else mean_where(distance, given)

    @torch.no_grad()
    def stylized(
        self, photographs: Float[Tensor, "B V 3 H W"], style: Float[Tensor, "B 3 h w"]
    ) -> Float[Tensor, "B V 3 H W"]:
        """The target of the loss; all images are sRGB in [0, 1]."""
        vectors = self.painter.prediction(centre_square(style))
        return stylize_images(self.painter.transfer, photographs, vectors, working_size=self.working_size, joint=True)


def _difference(first: Float[Tensor, "B V 3 h w"], second: Float[Tensor, "B V 3 h w"]) -> Float[Tensor, " B"]:
    return (first - second).abs().flatten(1).mean(1)
