"""Balanced draws: sets over scenes and styles, positions over participants and sets, orders over participants."""

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Bool, Int
from scipy import optimize, sparse


def draw_pairs(available: Bool[np.ndarray, "S T"], count: int, generator: np.random.Generator) -> list[tuple[int, int]]:
    """Draw ``count`` different scene-style pairs, as evenly over scenes and over styles as the available ones allow.

    Raises:
        ValueError: Fewer pairs are available.
    """
    pairs = np.argwhere(available)
    if len(pairs) < count:
        raise ValueError(
            f"{count} sets are asked for and {len(pairs)} pairs of scene and style have results of every method; "
            f"plan at most {len(pairs) - len(pairs) % 2} sets, or add results"
        )
    chosen = _evenly(pairs, available.shape, count, generator)
    return [(int(scene), int(style)) for scene, style in generator.permutation(pairs[chosen])]


def balanced_subsets(
    pairs: Int[np.ndarray, "pool 2"], count: int, rounds: int, generator: np.random.Generator
) -> Int[np.ndarray, "rounds count"]:
    """Subsets of a pool of scene-style pairs: every set as often as every other one, or once more.

    Within that, each subset is as even over scenes and over styles as it can be. Of a pool of ``count``, all are taken.
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
    """Which pairs to take, at least ``low`` and at most ``high`` of each: the most even draw, ties by chance.

    A transport problem with random costs, whose corners are whole; evenness gives way until there is a solution.
    """
    costs = generator.random(len(pairs))
    for slack in range(count + 1):
        rows: list[sparse.csr_array] = []
        bounds: list[tuple[int, int]] = []
        for axis, size in enumerate(shape):
            member = (np.ones(len(pairs)), (pairs[:, axis], np.arange(len(pairs))))
            rows.append(sparse.csr_array(member, shape=(size, len(pairs))))
            bounds += [(max(math.floor(count / size) - slack, 0), math.ceil(count / size) + slack)] * size
        result = optimize.milp(
            costs,
            integrality=np.ones(len(pairs)),
            bounds=optimize.Bounds(low, high),
            constraints=[
                optimize.LinearConstraint(sparse.vstack(rows), *np.transpose(bounds).tolist()),
                optimize.LinearConstraint(np.ones((1, len(pairs))), count, count),
            ],
        )
        if result.x is not None:
            return np.flatnonzero(result.x > 0.5)
    raise AssertionError("any pairs at all fit within a slack of as many")


def balanced_positions(
    participants: int, sets: int, generator: np.random.Generator
) -> Bool[np.ndarray, "participants sets"]:
    """Where ours is A: in half of every participant's sets, and for half of the participants in every set.

    Participants come in pairs that see everything the other way round, so that the first 2k are balanced for any k.
    """
    assert participants % 2 == 0
    assert sets % 2 == 0
    half = np.arange(sets) < sets // 2
    first = generator.permuted(np.tile(half, (participants // 2, 1)), axis=1)
    return np.stack([first, ~first], axis=1).reshape(participants, sets)


def latin_orders(participants: int, sets: int, generator: np.random.Generator) -> Int[np.ndarray, "participants sets"]:
    """The order of the sets for each participant: rows of a Williams square, shuffled.

    In a whole square every set stands once in every place and follows every other one equally often.
    """
    zigzag = np.array([step // 2 if step % 2 == 0 else sets - (step + 1) // 2 for step in range(sets)])
    square = (zigzag[None, :] + np.arange(sets)[:, None]) % sets
    if sets % 2:
        square = np.concatenate([square, square[:, ::-1]])
    names = generator.permutation(sets)
    rows = [generator.permutation(len(square)) for _ in range(math.ceil(participants / len(square)))]
    return names[square[np.concatenate(rows)[:participants]]]


def spread_checks(order: Sequence[str], checks: Sequence[str], generator: np.random.Generator) -> list[str]:
    """An order with attention checks put in, one in each of as many equal stretches, never first."""
    mixed = list(order)
    edges = np.linspace(1, len(order), len(checks) + 1).astype(int)
    indices = [int(generator.integers(low, max(high, low + 1))) for low, high in pairwise(edges.tolist())]
    for index, check in sorted(zip(indices, checks, strict=True), reverse=True):
        mixed.insert(index, check)
    return mixed
