"""AdamW whose weight decay spares biases, gains and single vectors."""

from collections.abc import Sequence
from typing import Any

import torch
from torch import nn

from anystyle.training.optim import scheduled, trainable


def decayed_adamw(
    module: nn.Module,
    *,
    lr: float,
    weight_decay: float,
    steps: int,
    warmup: int,
    betas: tuple[float, float] = (0.9, 0.98),
    floor: float = 0.01,
) -> dict[str, Any]:
    """AdamW on the trainable parameters of a module; the rate falls to ``floor * lr`` at the last of ``steps``."""
    optimizer = torch.optim.AdamW(decayed_groups([module], lr=lr, weight_decay=weight_decay), betas=betas)
    return scheduled(optimizer, total=steps - warmup, warmup=warmup, floor=floor * lr)


def decayed_groups(modules: Sequence[nn.Module], *, lr: float, weight_decay: float) -> list[dict[str, Any]]:
    """Parameter groups in which matrices decay; biases, gains and single vectors do not."""
    matrices, vectors = [], []
    for parameter in trainable(modules):
        (matrices if parameter.ndim > 1 else vectors).append(parameter)
    groups = ((matrices, weight_decay), (vectors, 0.0))
    return [{"params": params, "lr": lr, "weight_decay": decay} for params, decay in groups if params]
