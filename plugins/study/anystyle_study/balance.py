"""Balanced draws of sets, of positions (which side ours is on) and of orders."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from scipy import optimize

from anystyle.errors import UserError


def draw_pairs(
    available: Bool[np.ndarray, "S T *P"], count: int, generator: np.random.Generator, *, once: bool = True
) -> list[tuple[int, ...]]:
    """Draw ``count`` different scene-style pairs, as evenly over scenes and over styles as the available ones allow.

    With a third axis, of pairs of methods, as evenly over these, too, and within scenes and within styles; unless
    ``once``, a scene and style may be drawn with several of them.
    """
    found = np.argwhere(available)
    most = len(np.unique(found[:, :2], axis=0)) if once else len(found)
    if most < count:
        what = "pairs of scene and style have results of every method"
        what = what if once else "pairs of methods are there in all scenes and styles"
        raise UserError(
            f"{count} sets are asked for and {most} {what}; plan at most {most - most % 2} sets (pool=, sets=), or "
            "add results"
        )
    return [tuple(row) for row in generator.permutation(found[_evenly(found, count, generator)]).tolist()]


def balanced_subsets(
    sets: Int[np.ndarray, "pool F"], count: int, rounds: int, generator: np.random.Generator
) -> Int[np.ndarray, "rounds count"]:
    """Draw ``rounds`` subsets of a pool of sets; how often two sets are drawn differs by at most one.

    Within that, each subset is as even over scenes, styles and further factors (columns) as possible.
    """
    times = np.zeros(len(sets), dtype=int)
    subsets = []
    for _ in range(rounds):
        threshold = np.sort(times)[count - 1]
        subset = _evenly(sets, count, generator, low=times < threshold, high=times <= threshold)
        times[subset] += 1
        subsets.append(subset)
    return np.array(subsets)


def _evenly(
    sets: Int[np.ndarray, "N F"],
    count: int,
    generator: np.random.Generator,
    low: Any = 0,  # scipy's stubs know single bounds only
    high: Any = 1,
) -> Int[np.ndarray, " count"]:
    """Indices of the most even draw over each factor, and over every two factors together, such as scenes and styles.

    At least ``low`` and at most ``high`` of each set, ties at random. A transport problem with random costs; the
    evenness over one after the other is relaxed until there is a solution.
    """
    costs, number = generator.random(len(sets)), sets.shape[1]
    # In the order in which they are to be even.
    labels = [*sets.T[2:], sets[:, :2], *sets.T[:2], *(sets[:, [a, b]] for b in range(2, number) for a in range(b))]
    factors = [np.unique(each, axis=0, return_inverse=True)[1].ravel() for each in labels]
    slack = [0] * len(factors)

    def solved() -> Any:
        constraints = [optimize.LinearConstraint(np.ones((1, len(sets))), count, count)]
        for levels, wider in zip(factors, slack, strict=True):
            size = levels.max() + 1
            members = (np.arange(size)[:, None] == levels).astype(float)
            each = math.floor(count / size) - wider, math.ceil(count / size) + wider
            constraints.append(optimize.LinearConstraint(members, *each))
        return optimize.milp(costs, integrality=1, bounds=optimize.Bounds(low, high), constraints=constraints).x

    if (found := solved()) is None:
        slack[:] = [count] * len(factors)
        for index in range(len(factors)):
            for slack[index] in range(count + 1):
                if (found := solved()) is not None:
                    break
    return np.flatnonzero(np.asarray(found, float) > 0.5)


def balanced_positions(
    participants: int, sets: int, generator: np.random.Generator
) -> Bool[np.ndarray, "participants sets"]:
    """Where ours is A: in half of every participant's sets, and for half of the participants in every set.

    Participants come in pairs with opposite positions, so that the first 2k are balanced for any k.
    """
    half = np.arange(sets) < sets // 2
    first = generator.permuted(np.tile(half, (participants // 2, 1)), axis=1)
    return np.stack([first, ~first], axis=1).reshape(participants, sets)


def latin_orders(participants: int, sets: int, generator: np.random.Generator) -> Int[np.ndarray, "participants sets"]:
    """The order of the sets for each participant: rows of a Williams square, shuffled.

    In a whole square every set has every rank once and follows every other set equally often.
    """
    zigzag = np.array([step // 2 if step % 2 == 0 else sets - (step + 1) // 2 for step in range(sets)])
    square = (zigzag[None, :] + np.arange(sets)[:, None]) % sets
    if sets % 2:
        square = np.concatenate([square, square[:, ::-1]])
    names = generator.permutation(sets)
    rows = [generator.permutation(len(square)) for _ in range(math.ceil(participants / len(square)))]
    return names[square[np.concatenate(rows)[:participants]]]


def spread_checks(order: Sequence[str], checks: Sequence[str], generator: np.random.Generator) -> list[str]:
    """Insert attention checks into an order, one in each of equally long stretches, never first."""
    mixed = list(order)
    edges = np.linspace(1, len(order), len(checks) + 1).astype(int)
    indices = [int(generator.integers(low, max(high, low + 1))) for low, high in pairwise(edges.tolist())]
    for index, check in sorted(zip(indices, checks, strict=True), reverse=True):
        mixed.insert(index, check)
    return mixed
