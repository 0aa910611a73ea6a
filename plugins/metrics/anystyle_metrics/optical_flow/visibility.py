"""Which pixels of a frame are visible in the other one, by the flows between the two."""

from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.geometry.warp import pixels, sample_at

RELATIVE, SLACK = 0.01, 0.5
"""Allowed squared error of a cycle: ``SLACK`` pixels² and ``RELATIVE`` times the squared displacements."""


def inside(flow: Float[Tensor, "M 2 H W"]) -> Bool[Tensor, "M H W"]:
    """Where the flow stays in the frame."""
    height, width = flow.shape[-2:]
    x, y = (pixels(flow) + flow).unbind(1)
    return (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)


def cycle_visible(forward: Float[Tensor, "M 2 H W"], backward: Float[Tensor, "M 2 H W"]) -> Bool[Tensor, "M H W"]:
    """Where following the flow there and back returns to the start (Sundaram, Brox and Keutzer, ECCV 2010, Eq. 5)."""
    sampled = sample_at(backward, forward)
    error = (forward + sampled).square().sum(1)
    allowed = RELATIVE * (forward.square().sum(1) + sampled.square().sum(1)) + SLACK
    return (error <= allowed) & inside(forward)
