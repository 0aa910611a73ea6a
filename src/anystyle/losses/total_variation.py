"""Total variation: prefer smooth images."""

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.types import Stylization


class TotalVariation(Loss):
    """Prefer smooth renders: mean squared difference of neighbouring pixels, down plus across.

    The squared form of Johnson et al. 2016 as ARF and its successors use it.

    Args:
        weight: In the objective; 1 in ARF and StylizedGS, 10 in Stylos, 1e-4 in G-Style.
    """

    def __init__(self, *, weight: float = 1.0) -> None:
        super().__init__()
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color = result.renders.color
        down = color[..., 1:, :] - color[..., :-1, :]
        across = color[..., :, 1:] - color[..., :, :-1]
        return down.square().mean() + across.square().mean()
