"""Sampling of scenes, views, sizes and styles for a training step.

Stateless: a draw is a function of the seed and the step, so that a resumed run draws what an uninterrupted one
draws, and all processes of a distributed run agree without communication.
"""

from collections.abc import Sequence

import numpy as np

from anystyle.errors import UserError


def gap_bounds(context: int, total: int) -> tuple[int, int]:
    """Least and largest distance between the first and the last context view of a capture of ``total`` frames."""
    low = min(3 * context, 32)
    high = min(max(5 * context, context * context), 256, total - 1)
    if high < low:
        raise UserError(
            f"a scene of {total} frames is too short for {context} views at least {low} frames apart; "
            f"lower training.context_views or set training.spread=any"
        )
    return low, high


def bounded_views(rng: np.random.Generator, total: int, context: int, targets: int) -> list[int]:
    """The left end of a random window, views from within in random order, its right end; targets from the window."""
    if context == 1:
        return rng.choice(total, 1 + targets, replace=total < 1 + targets).tolist()
    low, high = gap_bounds(context, total)
    gap = int(rng.integers(low, high + 1))
    left = int(rng.integers(0, total - gap))
    right = left + gap
    between = rng.choice(np.arange(left + 1, right), context - 2, replace=False)
    return [left, *between.tolist(), right, *rng.integers(left, right + 1, targets).tolist()]


def any_views(rng: np.random.Generator, total: int, context: int, targets: int) -> list[int]:
    """Distinct views in random order."""
    if total < context + targets:
        raise UserError(
            f"a scene has {total} views, and {context} context and {targets} target views are asked for; "
            f"lower training.context_views or training.target_views"
        )
    return rng.permutation(total)[: context + targets].tolist()


def bounds(name: str, pair: Sequence[int]) -> tuple[int, int]:
    """The least and the greatest value of an option of a training."""
    if len(pair) != 2 or not 1 <= pair[0] <= pair[1]:
        raise UserError(f"training.{name}={list(pair)}: give the least and the greatest, at least 1, such as [2, 4]")
    return pair[0], pair[1]


def check_sides(low: int, high: int, *, width: int | None, multiple: int) -> None:
    """Refuse heights between which no multiple of the backbone's patch lies, and a width that is not one."""
    if -(-low // multiple) > high // multiple:
        raise UserError(
            f"training.heights=[{low}, {high}]: the backbone's patches are {multiple} pixels high, and no multiple of "
            f"that lies between; give one, such as [{max(1, low // multiple) * multiple}, "
            f"{-(-high // multiple) * multiple}]"
        )
    if width is not None and width % multiple:
        raise UserError(
            f"training.width={width}: the backbone's patches are {multiple} pixels wide; give a multiple of that, such "
            f"as {max(1, round(width / multiple)) * multiple}"
        )


def generator(*words: int) -> np.random.Generator:
    """A random generator seeded by all the words, in order."""
    return np.random.default_rng(np.random.SeedSequence([word % 2**32 for word in words]))
