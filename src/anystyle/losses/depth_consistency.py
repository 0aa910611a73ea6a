"""Depth consistency: keep the geometry of the scene."""

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.losses.features import Reference, unstyled_renders
from anystyle.types import Stylization


class DepthConsistency(Loss):
    """Keep the rendered depth at the depth the backbone predicted (paper, appendix D).

    Mean squared difference of the accumulated depth ``sum w z`` and the predicted map, over all pixels of the input
    views. Where only colours and rotations are styled, its gradient reaches only the rotations.

    Args:
        reference: ``photograph`` is the predicted map; ``render`` the accumulated depth of the unstyled scene, as in
            StylizedGS (Zhang et al. 2024, equation 7).
        weight: In the objective.

    Example:
        >>> result = inputs.stylization()
        >>> deeper = replace(result.renders, depth=result.scene.geometry.depth + 0.5)
        >>> DepthConsistency()(replace(result, renders=deeper))
        tensor(0.2500)
    """

    def __init__(self, *, reference: Reference = "photograph", weight: float = 0.1) -> None:
        super().__init__()
        self.needs_unstyled = reference == "render"
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        before = unstyled_renders(result) if self.needs_unstyled else result.scene.geometry
        return F.mse_loss(result.renders.depth, before.depth)
