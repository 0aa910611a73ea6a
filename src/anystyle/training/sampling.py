"""Sampling of scenes, views, sizes and styles for a training step.

Stateless: a draw is a function of the seed and the step, so that a continued run draws what an uninterrupted one
draws, and all processes of a distributed run agree without communication.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Draw:
    """One row of a batch.

    Args:
        key: Names the content; equal keys of equal draws see the same scene through the same views.
        scene: Index into the scene source.
        views: Indices of the context views, then of the target views.
        style: Index into the style source, 0 where there are none.
        flip: Whether the row is mirrored.
    """

    key: int
    scene: int
    views: tuple[int, ...]
    style: int
    flip: bool


def view_probabilities(counts: Sequence[int], power: float) -> np.ndarray:
    """Chances of the numbers of context views, in proportion to ``count**power``; the published runs use 2."""
    weights = np.asarray(counts, dtype=np.float64) ** power
    return weights / weights.sum()


def batch_rows(context: int, images: int) -> int:
    """How many scenes of ``context`` views make about ``images`` images."""
    return max(1, images // context)


def gap_bounds(context: int, total: int) -> tuple[int, int]:
    """Least and largest distance between the first and the last context view of a capture of ``total`` frames.

    Raises:
        ValueError: The capture is too short for so many views.
    """
    low = min(3 * context, 32)
    high = min(max(5 * context, context * context), 256, total - 1)
    if high < low:
        raise ValueError(
            f"a scene of {total} frames is too short for {context} views at least {low} frames apart; "
            f"lower training.context_views or set training.spread=any"
        )
    return low, high


def bounded_views(rng: np.random.Generator, total: int, context: int, targets: int) -> tuple[int, ...]:
    """A random window's left end, views from within in no order, its right end; then targets from the window."""
    if context == 1:
        return tuple(int(view) for view in rng.choice(total, 1 + targets, replace=total < 1 + targets))
    low, high = gap_bounds(context, total)
    gap = int(rng.integers(low, high + 1))
    left = int(rng.integers(0, total - gap))
    right = left + gap
    between = rng.choice(np.arange(left + 1, right), context - 2, replace=False)
    target_views = rng.integers(left, right + 1, targets)
    return tuple(int(view) for view in (left, *between, right, *target_views))


def any_views(rng: np.random.Generator, total: int, context: int, targets: int) -> tuple[int, ...]:
    """Distinct views in random order.

    Raises:
        ValueError: The scene has fewer views than asked for.
    """
    if total < context + targets:
        raise ValueError(
            f"a scene has {total} views, and {context} context and {targets} target views are asked for; "
            f"lower training.context_views or training.target_views"
        )
    return tuple(int(view) for view in rng.permutation(total)[: context + targets])


def bounds(name: str, pair: Sequence[int]) -> tuple[int, int]:
    """The least and the greatest of something, as given by an option of a training.

    Raises:
        ValueError: They are not two numbers in order, at least 1.
    """
    if len(pair) != 2 or not 1 <= pair[0] <= pair[1]:
        raise ValueError(f"training.{name}={list(pair)}: give the least and the greatest, at least 1, such as [2, 4]")
    return pair[0], pair[1]


def check_counts(**counts: int | None) -> None:
    """Refuse options of a training that count something and are below 1.

    Raises:
        ValueError: One is; the message names it.
    """
    for name, count in counts.items():
        if count is not None and count < 1:
            raise ValueError(f"training.{name}={count}: give at least 1")


def check_sides(low: int, high: int, *, width: int | None, multiple: int) -> None:
    """Refuse sizes of images that no step can have.

    Raises:
        ValueError: No multiple lies between the heights, or the width is none.
    """
    if -(-low // multiple) > high // multiple:
        raise ValueError(
            f"training.heights=[{low}, {high}]: the backbone's patches are {multiple} pixels high, and no multiple of "
            f"that lies between; give one, such as [{max(1, low // multiple) * multiple}, "
            f"{-(-high // multiple) * multiple}]"
        )
    if width is not None and width % multiple:
        raise ValueError(
            f"training.width={width}: the backbone's patches are {multiple} pixels wide; give a multiple of that, such "
            f"as {max(1, round(width / multiple)) * multiple}"
        )


def generator(*words: int) -> np.random.Generator:
    """A generator that depends on all the words, and on their order."""
    return np.random.default_rng(np.random.SeedSequence([word % 2**32 for word in words]))
