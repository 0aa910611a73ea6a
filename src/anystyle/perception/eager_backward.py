"""Gradients computed at once, so that what a network keeps for them is gone before the next one is run."""

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor


def eager_backward(
    function: Callable[[Tensor], Float[Tensor, ""]], images: Float[Tensor, "M 3 H W"]
) -> Float[Tensor, ""]:
    """``function(images)`` with its gradient, of which nothing is left to be computed.

    The terms of an objective run large frozen networks on the same images, one after the other. Differentiated at the
    end, the activations of all of them are in memory together; so, those of one. The numbers are the same, and so is
    the time. A second derivative there is none.

    Args:
        function: Of the images alone: what else it reads gets no gradient.
        images: What is looked at.
    """
    if not (torch.is_grad_enabled() and images.requires_grad):
        return function(images)
    leaf = images.detach().requires_grad_()
    value = function(leaf)
    if not value.requires_grad:
        # What it says does not depend on the images, such as of styles that lack what it reads.
        return value
    (gradient,) = torch.autograd.grad(value, leaf)
    known: Any = _Known.apply(images, value.detach(), gradient)
    return known


class _Known(torch.autograd.Function):
    """A value whose gradient is known."""

    @staticmethod
    def forward(ctx: Any, images: Tensor, value: Tensor, gradient: Tensor) -> Tensor:
        ctx.save_for_backward(gradient)
        return value.clone()

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(  # pyright: ignore[reportIncompatibleMethodOverride]
        ctx: Any, *grads: Tensor
    ) -> tuple[Tensor, None, None]:
        (gradient,) = ctx.saved_tensors
        return grads[0] * gradient, None, None
