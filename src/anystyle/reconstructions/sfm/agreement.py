"""How far two sparse models of the same photographs agree."""

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float64

from anystyle.geometry.similarity import similarity_of_cameras

Array = np.ndarray
TRIMS = 8
"""Rounds of fitting a similarity to the views that agree best."""


class Agreement(NamedTuple):
    """Differences of views that two models have in common, after a similarity that fits most of them.

    Args:
        rotation: In degrees.
        position: As a share of the root mean square distance of the cameras from their mean.
    """

    rotation: Float64[Array, " V"]
    position: Float64[Array, " V"]

    def within(self, rotation: float, position: float) -> Bool[Array, " V"]:
        """Which views differ by no more."""
        return (self.rotation <= rotation) & (self.position <= position)


def agreement(first: Float64[Array, "V 4 4"], second: Float64[Array, "V 4 4"]) -> Agreement:
    """Compare the poses that two models give to the same views, at least 2.

    The similarity is fitted to all views and then again and again to the better half of them (at least 3), so that
    less than half of the views may be anywhere.
    """
    chosen = np.arange(len(first))
    result = _differences(first, second, chosen)
    for _ in range(TRIMS):
        cost = result.position + result.rotation / 30
        closest = np.sort(np.argsort(cost, kind="stable")[: max(3, (len(first) + 1) // 2)])
        if np.array_equal(closest, chosen):
            break
        chosen = closest
        result = _differences(first, second, chosen)
    return result


def _differences(first: Float64[Array, "V 4 4"], second: Float64[Array, "V 4 4"], chosen: Array) -> Agreement:
    similarity = similarity_of_cameras(torch.from_numpy(first[chosen]), torch.from_numpy(second[chosen]))
    moved = similarity.poses(torch.from_numpy(first)).numpy()
    turn = np.einsum("vji,vjk->vik", moved[:, :3, :3], second[:, :3, :3])
    angle = np.degrees(np.arccos(np.clip((np.trace(turn, axis1=1, axis2=2) - 1) / 2, -1, 1)))
    position = second[:, :3, 3]
    spread = np.sqrt(np.square(position - position.mean(0)).sum(1).mean())
    return Agreement(angle, np.linalg.norm(moved[:, :3, 3] - position, axis=1) / max(float(spread), 1e-12))
