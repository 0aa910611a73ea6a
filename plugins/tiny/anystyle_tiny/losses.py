"""Losses of the tiny experiments."""

from typing import Annotated

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.ranges import NonNegative, Range
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

    Example:
        >>> import torch
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> renders = replace(result.renders, color=result.views.images + torch.tensor([0.0, 0.1]).repeat(40))
        >>> Checkerboard()(replace(result, renders=renders))  # the mean amplitude of stripes
        tensor(0.0500)
    """

    def __init__(self, *, period: Annotated[int, Range(ge=2)] = 14, weight: float = 40.0) -> None:
        super().__init__()
        self.period = period
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        # A last, partial patch is left out.
        change = (result.renders.color - result.views.images).flatten(0, 1)
        rows, columns = (side // self.period for side in change.shape[-2:])
        whole = change[..., : rows * self.period, : columns * self.period]
        repeated = whole.unflatten(-2, (rows, -1)).unflatten(-1, (columns, -1)).mean((-4, -2))
        return (repeated - repeated.mean((-2, -1), keepdim=True)).abs().mean()


class EdgeAwareSmoothness(Loss):
    """Prefer renders that change where the photographs do: ``mean |dx I| exp(-k |dx I^photograph|)``, across plus down.

    The first-order smoothness of Godard et al. 2017 (Eq. 2 there, on disparities), on colours: absolute differences of
    neighbouring pixels, averaged over channels. Terms on the distribution of colours allow stripes unrelated to
    the scene; this one penalises them, but not the edges of the scene.

    Args:
        sharpness: The ``k`` above, for differences of sRGB in [0, 1].
        weight: In the objective.

    Example:
        >>> import torch
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> ramp = torch.linspace(0, 0.79, 80).expand_as(result.views.images)  # steps of 0.01 across
        >>> EdgeAwareSmoothness(sharpness=0.0)(replace(result, renders=replace(result.renders, color=ramp)))
        tensor(0.0100)
    """

    def __init__(self, *, sharpness: NonNegative = 20.0, weight: float = 1.0) -> None:
        super().__init__()
        self.sharpness, self.weight = sharpness, weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color, photograph = result.renders.color, result.views.images
        terms = []
        for axis in (-1, -2):
            edges = photograph.diff(dim=axis).abs().mean(2, keepdim=True)
            terms.append((color.diff(dim=axis).abs() * (-self.sharpness * edges).exp()).mean())
        return terms[0] + terms[1]
