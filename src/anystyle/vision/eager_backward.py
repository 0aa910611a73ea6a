"""Gradients computed at once, so that a network's activations are freed before the next network runs."""

from collections.abc import Callable

import torch
from jaxtyping import Float
from torch import Tensor


def eager_backward(
    function: Callable[[Tensor], Float[Tensor, ""]], images: Float[Tensor, "M 3 H W"]
) -> Float[Tensor, ""]:
    """``function(images)``, backpropagated to the images at once, to free activations.

    The terms of an objective run large frozen networks on the same images one after another. Differentiated together
    at the end, the activations of all are in memory at once; with this, those of one. Nothing but the images gets a
    gradient, and there is no second derivative.
    """
    if not (torch.is_grad_enabled() and images.requires_grad):
        return function(images)
    leaf = images.detach().requires_grad_()
    value = function(leaf)
    if not value.requires_grad:  # it does not depend on the images, such as for styles without an image
        return value
    (gradient,) = torch.autograd.grad(value, leaf)
    # The added product is 0 and has this gradient.
    return value.detach() + ((images - images.detach()) * gradient).sum()
