"""Brightness: the smallest loss on renders."""

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.types import Stylization


class ToyLoss(Loss):
    """Keep the mean brightness of each view at the photograph's: mean squared difference.

    Args:
        weight: In the objective.
    """

    def __init__(self, *, weight: float = 1.0) -> None:
        super().__init__()
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        return (result.renders.color.mean((2, 3, 4)) - result.views.images.mean((2, 3, 4))).square().mean()
