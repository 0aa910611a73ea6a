"""Total variation: prefer smooth images."""

from typing import Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.types import Stylization


class TotalVariation(Loss):
    """Prefer smooth renders: mean squared difference of neighbouring pixels, down plus across.

    The squared form of Johnson et al. 2016 as ARF and its successors use it.

    Args:
        reduction: ``mean`` over pixels and channels, or their ``sum`` in each view, as in G-Style.
        weight: In the objective; 1 in ARF and StylizedGS, 10 in Stylos, 1e-4 of the sum in G-Style.

    Example:
        >>> import torch
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> stripes = (0.5 * (torch.arange(result.renders.color.shape[-1]) % 2)).expand_as(result.renders.color)
        >>> TotalVariation()(replace(result, renders=replace(result.renders, color=stripes)))
        tensor(0.2500)
    """

    def __init__(self, *, reduction: Literal["mean", "sum"] = "mean", weight: float = 1.0) -> None:
        super().__init__()
        self.reduction: Literal["mean", "sum"] = reduction
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color = result.renders.color.flatten(0, 1)
        squares = (color.diff(dim=-2).square(), color.diff(dim=-1).square())
        if self.reduction == "mean":
            return squares[0].mean() + squares[1].mean()
        return (squares[0].sum() + squares[1].sum()) / len(color)
