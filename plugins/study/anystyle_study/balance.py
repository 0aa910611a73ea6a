"""Balanced draws of sets, of positions (which side ours is on) and of orders."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from scipy import optimize

from anystyle.errors import UserError


def draw_pairs(available: Bool[np.ndarray, "S T"], count: int, generator: np.random.Generator) -> list[tuple[int, int]]:
    """Draw ``count`` different scene-style pairs, as evenly over scenes and over styles as the available ones allow."""
    pairs = np.argwhere(available)
    if len(pairs) < count:
        raise UserError(
            f"{count} sets are asked for and {len(pairs)} pairs of scene and style have results of every method; "
            f"plan at most {len(pairs) - len(pairs) % 2} sets, or add results"
        )
    chosen = _evenly(pairs, available.shape, count, generator)
    return [(int(scene), int(style)) for scene, style in generator.permutation(pairs[chosen])]


def balanced_subsets(
    pairs: Int[np.ndarray, "pool 2"], count: int, rounds: int, generator: np.random.Generator
) -> Int[np.ndarray, "rounds count"]:
    """Draw ``rounds`` subsets of a pool of scene-style pairs; how often two sets are drawn differs by at most one.

    Within that, each subset is as even over scenes and over styles as possible.
    """
    shape = tuple((pairs.max(axis=0) + 1).tolist())
    times = np.zeros(len(pairs), dtype=int)
    subsets = []
    for _ in range(rounds):
        threshold = np.sort(times)[count - 1]
        subset = _evenly(pairs, shape, count, generator, low=times < threshold, high=times <= threshold)
        times[subset] += 1
        subsets.append(subset)
    return np.array(subsets)


def _evenly(
    pairs: Int[np.ndarray, "N 2"],
    shape: tuple[int, ...],
    count: int,
    generator: np.random.Generator,
    low: Any = 0,  # scipy's stubs know single bounds only
    high: Any = 1,
) -> Int[np.ndarray, " count"]:
    """Indices of the most even draw of pairs, at least ``low`` and at most ``high`` of each; ties at random.

    A transport problem with random costs; the evenness is relaxed until there is a solution.
    """
    costs = generator.random(len(pairs))
    for slack in range(count + 1):
        constraints = [optimize.LinearConstraint(np.ones((1, len(pairs))), count, count)]
        for axis, size in enumerate(shape):
            members = np.arange(size)[:, None] == pairs[:, axis]
            each = math.floor(count / size) - slack, math.ceil(count / size) + slack
            constraints.append(optimize.LinearConstraint(members.astype(float), *each))
        result = optimize.milp(costs, integrality=1, bounds=optimize.Bounds(low, high), constraints=constraints)
        if result.x is not None:
            return np.flatnonzero(result.x > 0.5)
    raise AssertionError("any pairs at all fit within a slack of as many")


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
