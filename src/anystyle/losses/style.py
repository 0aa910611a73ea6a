"""Style: match the mean and spread of features."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle import perception
from anystyle.contracts import Loss
from anystyle.perception.compare import style_distance
from anystyle.perception.early import differentiated
from anystyle.perception.statistics import mean_std
from anystyle.types import Stylization


class Style(Loss):
    """Match mean and deviation of VGG features of the style image (paper section 3.3; AdaIN, equation 13).

    ``sum_l mean_c (mu - mu_style)^2 + mean_c (sigma - sigma_style)^2`` over the stylized views, averaged over those
    whose style has an image; a text alone adds nothing.

    Args:
        network: A network of :func:`anystyle.perception.load`.
        layers: Whose statistics.
        size: Side that renders and style images are squashed to; none keeps each as it is.
        relative: Each view's distance as the root of its ratio to the photograph's own; see ``style_distance``.
        weight: In the objective.
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1"),
        size: int | None = 224,
        relative: bool = False,
        weight: float = 1.0,
    ) -> None:
        super().__init__()
        self.network = perception.load(network)
        self.layers = tuple(layers)
        self.size = size
        self.relative = relative
        self.weight = weight

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """The bundled network, on small pictures."""
        return {"network": "texture", "size": 48}

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""

        def distance(images: Tensor) -> Tensor:
            color = images.unflatten(0, result.renders.color.shape[:2])
            return style_distance(
                replace(result, renders=replace(result.renders, color=color)),
                network=self.network,
                layers=self.layers,
                size=self.size,
                describe=_moments,
                relative=self.relative,
            )

        return differentiated(distance, result.renders.color.flatten(0, 1))


def _moments(layer: str, features: Tensor) -> Tensor:
    return torch.stack(mean_std(features), dim=1)
