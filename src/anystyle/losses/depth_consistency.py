"""Depth consistency: a styled scene keeps the shape of the scene."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.types import Stylization


class DepthConsistency(Loss):
    """Keep the rendered depth at the depth the backbone predicted (paper, appendix D).

    Mean squared difference of the accumulated depth ``sum w z`` and the predicted map, over all pixels of the input
    views. Where only colours and rotations are styled, its gradient reaches the rotations alone.

    Args:
        weight: In the objective.
    """

    def __init__(self, *, weight: float = 0.1) -> None:
        super().__init__()
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        """See :meth:`anystyle.contracts.Loss.forward`."""
        return F.mse_loss(result.renders.depth, result.scene.geometry.depth)
