"""Exposure of photographs: a gain and a bias for each channel of each view."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras

NEAREST = 2
"""A view that was held out has the exposure of so many training views beside it."""


class Exposures:
    """Gains and biases that bring renders to photographs; on average over the training views they change nothing.

    Args:
        cameras: Of one scene.
        training: Views whose exposure is learnt.
    """

    def __init__(self, cameras: Cameras, training: list[int]) -> None:
        self.centers = cameras.world_from_camera[0, :, :3, 3]
        self.values = torch.zeros(len(self.centers), 6, device=self.centers.device).requires_grad_()
        self.train(training)

    def train(self, training: list[int]) -> None:
        """Say which views' exposure is learnt; the others have that of the views beside them."""
        distance = torch.cdist(self.centers, self.centers[training])  # V T
        nearest = distance.topk(min(NEAREST, len(training)), largest=False)
        weight = 1 / nearest.values.clamp_min(1e-9)
        blend = torch.zeros_like(distance).scatter(1, nearest.indices, weight / weight.sum(1, keepdim=True))
        blend[training] = torch.eye(len(training)).to(blend)
        self.training, self.blend = training, blend

    def of(self, view: int) -> Float[Tensor, " 6"]:
        """Gain - 1 and bias of a view; of one that was held out, those of the training views nearest to it."""
        return self.blend[view] @ self.values[self.training]

    def apply(self, images: Float[Tensor, "M 3 H W"], view: int) -> Float[Tensor, "M 3 H W"]:
        """Expose renders as a view was exposed."""
        gain, bias = self.of(view)[:, None, None].split(3)
        return images * (1 + gain) + bias

    @torch.no_grad()
    def center(self) -> None:
        """Take out what all training views have in common: the Gaussians can learn that."""
        self.values[self.training] -= self.values[self.training].mean(0)
