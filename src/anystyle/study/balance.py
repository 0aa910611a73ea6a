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

    Of all most even draws one is chosen at random: a transport problem with random costs, whose corners are whole.

    Raises:
        ValueError: Fewer pairs are available.
    """
    pairs = np.argwhere(available)
    if len(pairs) < count:
        raise ValueError(
            f"{count} sets are asked for and {len(pairs)} pairs of scene and style have results of every method; "
            f"plan at most {len(pairs) - len(pairs) % 2} sets, or add results"
        )
    costs = generator.random(len(pairs))
    for slack in range(count + 1):
        chosen = _transport(pairs, available.shape, count, slack, costs)
        if chosen is not None:
            return [(int(scene), int(style)) for scene, style in generator.permutation(pairs[chosen])]
    raise AssertionError("any pairs at all fit within a slack of as many")


def _transport(
    pairs: np.ndarray, shape: tuple[int, ...], count: int, slack: int, costs: np.ndarray
) -> np.ndarray | None:
    """Which pairs to take, every scene and style within ``slack`` of its even share; ``None`` if there is no way."""
    rows: list[sparse.csr_array] = []
    low: Any = []  # scipy's stubs know single bounds only
    high: Any = []
    for axis, size in enumerate(shape):
        member = sparse.csr_array(
            (np.ones(len(pairs)), (pairs[:, axis], np.arange(len(pairs)))), shape=(size, len(pairs))
        )
        rows.append(member)
        low += [max(math.floor(count / size) - slack, 0)] * size
        high += [math.ceil(count / size) + slack] * size
    result = optimize.milp(
        costs,
        integrality=np.ones(len(pairs)),
        bounds=optimize.Bounds(0, 1),
        constraints=[
            optimize.LinearConstraint(sparse.vstack(rows), low, high),
            optimize.LinearConstraint(np.ones((1, len(pairs))), count, count),
        ],
    )
    return None if result.x is None else np.flatnonzero(result.x > 0.5)


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
