"""Optimal transport: match features of a render with those of the style image, none of them too often."""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.losses.features import drawn_for_rows
from anystyle.ranges import AtLeastOne, Positive, Range
from anystyle_methods.nnfm import NNFM


class OptimalTransport(NNFM):
    """Bring features of a render near those that optimal transport of limited capacity matches them with.

    ``min_P sum_ij P_ij (1 - cos(F_i, F_j^style)) - epsilon H(P)`` over plans ``P`` that move ``1 / N`` from each of N
    features of a render and at most ``capacity / M`` to each of M features of the style image, averaged over views
    whose style has an image. The limit keeps many places from taking one patch of the painting, as nearest neighbours
    let them: without one, and at ``epsilon`` of 0, this is NNFM. The gradient takes the plan as fixed.

    Args:
        layers: Layers of one resolution.
        weight: Weight in the objective.
        capacity: How often a feature of the style image is used, relative to its equal share: 1 or more. At 1 the plan
            is balanced, and all features are used alike.
        epsilon: Weight of the entropy, in units of ``1 - cos``.
        iterations: Iterations of Sinkhorn's algorithm.
        num_samples: Features of a view and of the style image that are drawn at random each time.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> from anystyle.types import Style
        >>> red, green = torch.eye(3)[:2, :, None, None]
        >>> result = stylization()
        >>> renders = replace(result.renders, color=red.expand_as(result.renders.color))
        >>> loss = OptimalTransport(network="texture", layers=("rgb",), num_samples=64)
        >>> value = loss(replace(result, renders=renders, style=Style(image=green.expand(1, 3, 16, 16))))
        >>> round(float(value), 4)
        1.0
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu3_1", "relu3_2", "relu3_3"),
        size: int | None = 224,
        weight: float = 1.0,
        capacity: Annotated[float, Range(ge=1)] = 2.0,
        epsilon: Positive = 0.01,
        iterations: AtLeastOne = 50,
        num_samples: AtLeastOne = 1024,
    ) -> None:
        super().__init__(network=network, layers=layers, size=size, weight=weight)
        self.capacity, self.epsilon, self.iterations, self.num_samples = capacity, epsilon, iterations, num_samples

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {**super().example(folder), "num_samples": 64, "iterations": 5}

    def distances(
        self, features: Float[Tensor, "M C S"], targets: Float[Tensor, "M C T"], *, rows: int
    ) -> Float[Tensor, " M"]:
        def draw(number: int) -> list[Any]:
            views, counts = range(len(features) // rows), (features.shape[2], targets.shape[2])
            return [[self._drawn(count) for _ in views for count in counts] for _ in range(number)]

        chosen = iter(chain.from_iterable(drawn_for_rows(rows, draw)))
        pairs = zip(features, targets, strict=True)
        return torch.stack([self.distance(one[:, next(chosen)], other[:, next(chosen)]) for one, other in pairs])

    def distance(self, features: Float[Tensor, "C S"], target: Float[Tensor, "C T"]) -> Float[Tensor, ""]:
        cost = 1 - features.mT @ target
        return (transport_plan(cost.detach(), self.capacity, self.epsilon, self.iterations) * cost).sum()

    def _drawn(self, count: int) -> slice | Int[Tensor, " N"]:
        return slice(None) if count <= self.num_samples else torch.randperm(count)[: self.num_samples]


LARGEST = 1e30
"""Factors are kept below it."""
LEAST = -69.0
"""Logarithm of the least share of a row; products with denormal numbers take a hundred times as long."""
ABSORBED = 10
"""Iterations of factors before they are taken into the logarithms, so that no exponential leaves single precision."""


def transport_plan(
    cost: Float[Tensor, "N M"], capacity: float, epsilon: float, iterations: int
) -> Float[Tensor, "N M"]:
    """The plan of least cost that moves ``1 / N`` from each row and at most ``capacity / M`` to each column.

    Sinkhorn's algorithm: rows are scaled to their sums, columns where they exceed their limit (Benamou et al. 2015,
    section 5), by factors that are now and then absorbed into the kernel (Schmitzer 2019, algorithm 2). Rows have
    their exact sums.
    """
    (rows, columns), kernel = cost.shape, -cost / epsilon
    mass, limit = 1 / rows, capacity / columns

    def with_exact_rows(column: Float[Tensor, " M"]) -> Float[Tensor, "N M"]:
        return mass * (kernel + column).log_softmax(1).clamp_min(LEAST).exp()

    column = cost.new_zeros(columns)
    for done in range(0, iterations, ABSORBED):
        plan, factor = with_exact_rows(column), torch.ones_like(column)
        highest = (-column).exp().clamp_max(LARGEST)  # the potential of a column that is not full is 0
        for _ in range(min(ABSORBED, iterations - done)):
            row = mass / (plan @ factor).clamp_min(1 / LARGEST)
            factor = (limit / (plan.mT @ row)).minimum(highest)
        column = column + factor.log()
    return with_exact_rows(column)
