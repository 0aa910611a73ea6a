"""Attribute change: penalise changes of scales and opacities."""

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.types import Stylization


class AttributeChange(Loss):
    """Penalise changes of scales and opacities (StylizedGS, Zhang et al. 2024, section 3.3).

    ``s mean |scale - scale^before| + o mean |opacity - opacity^before|``; 0 without Gaussians.

    Args:
        scale_weight: ``s``; the default is ours.
        opacity_weight: ``o``; likewise.
        weight: In the objective.

    Example:
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()  # whose scene has 0.9 of its opacities
        >>> change = AttributeChange(scale_weight=0, opacity_weight=1)(result)
        >>> round(float((change / result.gaussians.opacities.mean()).detach()), 3)
        0.1
    """

    def __init__(self, *, scale_weight: float = 0.05, opacity_weight: float = 0.05, weight: float = 1.0) -> None:
        super().__init__()
        self.scale_weight, self.opacity_weight, self.weight = scale_weight, opacity_weight, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        before, after = result.scene.gaussians, result.gaussians
        if before is None:
            return 0.0 * result.renders.color.sum()
        scale = (after.scales - before.scales).abs().mean()
        return self.scale_weight * scale + self.opacity_weight * (after.opacities - before.opacities).abs().mean()
