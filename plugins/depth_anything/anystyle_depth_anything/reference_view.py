"""Which view the others are seen from: chosen from the class tokens, ahead of the first attention across views."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

Strategy = Literal["saddle_balanced", "saddle_sim_range", "middle", "first"]
LEAST_VIEWS = 3
"""With fewer views the first one is the reference, whatever the strategy."""


def reference_view(tokens: Float[Tensor, "B V C"], strategy: Strategy) -> Int[Tensor, " B"]:
    """The view of each scene that becomes its reference.

    Args:
        tokens: One a view.
        strategy: ``saddle_balanced``: the view that is nearest to the middle of the range in similarity to the
            others, norm and spread of its token; ``saddle_sim_range``: one of the two most alike, which of them is a
            matter of rounding, for a view's similarity to itself counts as 0; ``middle`` and ``first`` of the capture.
    """
    batch, views, _ = tokens.shape
    if views < LEAST_VIEWS or strategy == "first":
        return torch.zeros(batch, dtype=torch.long, device=tokens.device)
    if strategy == "middle":
        return torch.full((batch,), views // 2, dtype=torch.long, device=tokens.device)
    unit = F.normalize(tokens.float(), dim=-1)
    with torch.autocast(tokens.device.type, enabled=False):
        alike = unit @ unit.mT - torch.eye(views, device=tokens.device)
    if strategy == "saddle_sim_range":
        return (alike.amax(-1) - alike.amin(-1)).argmax(-1)
    figures = [alike.sum(-1) / (views - 1), tokens.float().norm(dim=-1), unit.var(dim=-1)]
    return torch.stack([(_of_range(figure) - 0.5).abs() for figure in figures]).sum(0).argmin(-1)


def order_of(reference: Int[Tensor, " B"], views: int) -> Int[Tensor, "B V"]:
    """The order in which the reference comes first and all others stay as they were."""
    index = torch.arange(views, device=reference.device).expand(len(reference), -1)
    return torch.where(index == reference[:, None], -1, index).argsort(dim=1, stable=True)


def in_order(data: Float[Tensor, "B V P C"], order: Int[Tensor, "B V"]) -> Float[Tensor, "B V P C"]:
    """The views in another order, scene by scene."""
    return data[torch.arange(len(data), device=data.device)[:, None], order]


def _of_range(figure: Float[Tensor, "B V"]) -> Float[Tensor, "B V"]:
    low, high = figure.amin(-1, keepdim=True), figure.amax(-1, keepdim=True)
    return (figure - low) / (high - low + 1e-8)
