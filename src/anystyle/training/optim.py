"""The learning-rate schedule and the parameter groups of the published recipe."""

import math
from collections.abc import Iterable
from typing import Any

import torch
from torch import nn
from torch.optim.lr_scheduler import LambdaLR


def learning_rate(
    step: int, *, peak: float, total: int, warmup: int = 100, start: float = 0.01, floor: float = 1e-5
) -> float:
    """The published schedule: a linear warm-up from ``start * peak``, then a cosine of ``total`` steps to ``floor``."""
    if step < warmup:
        return peak * (start + (1 - start) * step / warmup)
    progress = min(1.0, (step - warmup) / max(1, total))
    return floor + (peak - floor) * 0.5 * (1 + math.cos(math.pi * progress))


def scheduled(optimizer: torch.optim.Optimizer, *, total: int, warmup: int, floor: float) -> dict[str, Any]:
    """An optimiser with :func:`learning_rate` on each of its groups, as Lightning takes it."""

    def factor(peak: float) -> Any:
        return lambda step: learning_rate(step, peak=peak, total=total, warmup=warmup, floor=floor) / peak

    schedule = LambdaLR(optimizer, [factor(group["lr"]) for group in optimizer.param_groups])
    return {"optimizer": optimizer, "lr_scheduler": {"scheduler": schedule, "interval": "step", "name": "lr"}}


def trainable(modules: Iterable[nn.Module]) -> list[nn.Parameter]:
    """The parameters that require gradients, each once, in order."""
    parameters = {id(parameter): parameter for module in modules for parameter in module.parameters()}
    return [parameter for parameter in parameters.values() if parameter.requires_grad]
