"""Checkerboard: penalise artefacts that repeat with the patches of a network."""

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.types import Stylization


class Checkerboard(Loss):
    """Keep the change that a style makes free of a pattern that repeats with the patches.

    ``mean |m - mean m|`` with ``m``, of ``period x period`` pixels, the change from photograph to render averaged over
    all patches of a view. Transposed convolutions draw such patterns at no cost (Odena et al., Deconvolution and
    Checkerboard Artifacts, Distill 2016), and losses on statistics of features take them for strokes: strokes that
    follow the scene average out over patches, a lattice does not.

    Args:
        period: Side of a patch, in pixels; of the bundled backbones by default.
        weight: In the objective; values are near 0.01.
    """

    def __init__(self, *, period: int = 14, weight: float = 40.0) -> None:
        super().__init__()
        if period < 2:
            raise UserError(f"loss.checkerboard.period is {period}; give the side of a patch, 2 pixels or more")
        self.period = period
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        # A last, partial patch is left out.
        change = (result.renders.color - result.views.images).flatten(0, 1)
        rows, columns = (side // self.period for side in change.shape[-2:])
        whole = change[..., : rows * self.period, : columns * self.period]
        repeated = whole.unflatten(-2, (rows, -1)).unflatten(-1, (columns, -1)).mean((-4, -2))
        return (repeated - repeated.mean((-2, -1), keepdim=True)).abs().mean()
