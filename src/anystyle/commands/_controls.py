"""Flags of ``anystyle stylize`` that say how a style is applied."""

import argparse
from collections.abc import Sequence

from anystyle.inference.controls import Controls, combinations
from anystyle.inference.masks import parsed


def add_controls(parser: argparse.ArgumentParser) -> None:
    """Add them; each takes several values, and every combination is a result."""
    group = parser.add_argument_group("how a style is applied; several values make a strip")
    group.add_argument("--strength", action="append", default=[], metavar="0..1", help="0 is the unstyled scene")
    group.add_argument(
        "--preserve-color", action="append", default=[], metavar="0..1", help="keep the scene's hues; alone it means 1"
    )
    group.add_argument("--scale", action="append", default=[], metavar="FACTOR", help="size of strokes of --image")
    group.add_argument(
        "--mask",
        action="append",
        default=[],
        metavar="WHERE",
        help="where style enters: a folder of masks, sphere:X,Y,Z,RADIUS or box:X,Y,Z,X,Y,Z; ,soft=WIDTH behind it",
    )


def with_values(words: Sequence[str]) -> list[str]:
    """The words, and the value that ``--preserve-color`` alone stands for."""
    return ["--preserve-color=1" if _alone(words, index) else word for index, word in enumerate(words)]


def _alone(words: Sequence[str], index: int) -> bool:
    if words[index] != "--preserve-color" or "--" in words[:index]:
        return False
    following = words[index + 1] if index + 1 < len(words) else ""
    return not all(_is_number(word) for word in following.split(","))


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def given_controls(arguments: argparse.Namespace) -> list[Controls]:
    """Every combination of the values of the flags.

    Raises:
        ValueError: A value is no number, out of its range, or no mask.
    """
    return combinations(
        *(_numbers(flag, getattr(arguments, flag)) for flag in ("strength", "preserve_color", "scale")),
        mask=[parsed(word) for word in arguments.mask],
    )


def _numbers(flag: str, words: Sequence[str]) -> list[float]:
    values = ",".join(words).split(",") if words else []
    for word in values:
        if not _is_number(word):
            raise ValueError(f"--{flag.replace('_', '-')} takes numbers, not {word!r}")
    return [float(word) for word in values]
