"""Adam for parameters whose rows come and go."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import torch
from jaxtyping import Int
from torch import Tensor
from torch.autograd.graph import increment_version
from torch.optim.adam import adam

fused_adam = partial(adam, max_exp_avg_sqs=[], fused=True, amsgrad=False, weight_decay=0.0, maximize=False)


@dataclass
class Adam:
    """Adam (Kingma and Ba 2015) of named parameters, each with a learning rate, which may be set between steps.

    By PyTorch's fused kernel. ``torch.optim.Adam``, once made, imports PyTorch's compiler: 70 MB and almost a second.
    """

    parameters: dict[str, Tensor]
    rates: dict[str, float]
    betas: tuple[float, float] = (0.9, 0.999)
    eps: float = 1e-8

    def __post_init__(self) -> None:
        self.moments = {name: value.new_zeros(2, *value.shape) for name, value in self.parameters.items()}
        self.steps = {name: value.new_zeros(()) for name, value in self.parameters.items()}

    @torch.no_grad()
    def step(self) -> None:
        """Take a step with every parameter that has a gradient, and drop the gradients."""
        for name, value in self.parameters.items():
            if value.grad is not None:
                tensors, (beta1, beta2) = (value, value.grad, *self.moments[name]), self.betas
                rates = {"lr": self.rates[name], "beta1": beta1, "beta2": beta2, "eps": self.eps}
                fused_adam(*([tensor] for tensor in tensors), state_steps=[self.steps[name]], **rates)
                increment_version(value)  # which the kernel does not do
                value.grad = None

    @torch.no_grad()
    def select(self, index: Int[Tensor, " n"]) -> None:
        """Keep these rows of all parameters, which become new tensors, and of their moments."""
        for name, value in self.parameters.items():
            self.parameters[name] = value[index].requires_grad_()
            self.moments[name] = self.moments[name][:, index]

    def state_dict(self) -> dict[str, Any]:
        """All that is needed to resume; ``torch.save`` can write it."""
        return {"parameters": {**self.parameters}, "moments": self.moments, "steps": self.steps}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Restore the result of :meth:`state_dict`; the number of rows may differ."""
        self.parameters |= {
            name: value.detach().clone().requires_grad_() for name, value in state["parameters"].items()
        }
        self.moments, self.steps = state["moments"], state["steps"]
