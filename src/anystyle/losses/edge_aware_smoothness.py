"""Edge-aware smoothness: penalise edges that the photograph does not have."""

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.types import Stylization


class EdgeAwareSmoothness(Loss):
    """Prefer renders that change where the photographs do: ``mean |dx I| exp(-k |dx I^photograph|)``, across plus down.

    The first-order smoothness of Godard et al. 2017 (Eq. 2 there, on disparities), on colours: absolute differences of
    neighbouring pixels, averaged over channels. A term on the distribution of colours alone allows stripes
    unrelated to the scene; this one penalises them, but not the edges of the scene.

    Args:
        sharpness: The ``k`` above, for differences of sRGB in [0, 1].
        weight: In the objective.
    """

    def __init__(self, *, sharpness: float = 20.0, weight: float = 1.0) -> None:
        super().__init__()
        if sharpness < 0:
            raise UserError(f"loss.edge_aware_smoothness.sharpness is {sharpness}; give 0 or more")
        self.sharpness, self.weight = sharpness, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color, photograph = result.renders.color, result.views.images
        terms = []
        for axis in (-1, -2):
            edges = photograph.diff(dim=axis).abs().mean(2, keepdim=True)
            terms.append((color.diff(dim=axis).abs() * (-self.sharpness * edges).exp()).mean())
        return terms[0] + terms[1]
