"""Weight decay that spares biases, gains and single vectors."""

from collections.abc import Sequence
from typing import Any

from torch import nn

from anystyle.training.optim import trainable


def decayed_groups(modules: Sequence[nn.Module], *, lr: float, weight_decay: float) -> list[dict[str, Any]]:
    """Parameter groups in which matrices decay; biases, gains and single vectors do not."""
    matrices, vectors = [], []
    for parameter in trainable(modules):
        (matrices if parameter.ndim > 1 else vectors).append(parameter)
    groups = ((matrices, weight_decay), (vectors, 0.0))
    return [{"params": params, "lr": lr, "weight_decay": decay} for params, decay in groups if params]
