"""The term of Styl3R's objective that the paper of anystyle does not have."""

from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.types import Stylization
from anystyle.vision import networks
from anystyle.vision.eager_backward import eager_backward


class Identity(Loss):
    """Give the photographs back in the style of the scene's first photograph (Styl3R, arXiv 2505.21060).

    ``pixels * mean (render - photograph)^2 + sum_l mean (phi_l(render) - phi_l(photograph))^2``.

    Args:
        network: A network of :func:`anystyle.vision.networks.load`.
        layers: Whose features.
        pixels: Weight of the first summand.
        weight: In the objective.

    Example:
        >>> result, loss = inputs.stylization(), Identity(network="texture", layers=("relu1_1",))
        >>> same = replace(result.renders, color=result.views.images)
        >>> print(f"{loss(replace(result, identity=same)):.2f}")
        0.00
    """

    needs_identity = True

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"network": "texture", "layers": ("relu1_1", "relu2_1")}

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1"),
        pixels: float = 70.0,
        weight: float = 1.0,
    ) -> None:
        super().__init__()
        chosen = networks.choose(network, layers)
        self.network, self.layers = chosen.network, chosen.layers
        self.pixels, self.weight = pixels, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        if result.identity is None:
            raise UserError("identity compares renders in the style of the first photograph, and there are none")
        photographs = result.views.images.flatten(0, 1)
        with torch.no_grad():
            targets = self.network(photographs, self.layers)

        def value(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, ""]:
            pairs = zip(self.network(images, self.layers), targets, strict=True)
            return self.pixels * F.mse_loss(images, photographs) + sum(F.mse_loss(*pair) for pair in pairs)

        return eager_backward(value, result.identity.color.flatten(0, 1))
