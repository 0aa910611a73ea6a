"""Stylos with the weights that its goldens were computed with; another file of the same layout fits in their place."""

import itertools
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named, smooth_image
from tests.support.oracle import golden

FILE = os.environ.get("ANYSTYLE_STYLOS_GOLDEN", "golden_stylos")
"""The golden's name; a test of kept-back seeds sets another."""


@cache
def record() -> dict[str, Any]:
    return golden(FILE)


def expanded(keys: Sequence[Sequence[Any]]) -> dict[str, Tensor]:
    """The tensors of a list of ``[pattern, shape, indices of each #]``, without memory."""
    shapes = {}
    for pattern, shape, indices in keys:
        for numbers in itertools.product(*map(_numbers, indices)):
            parts = pattern.split("#")
            key = "".join(f"{part}{number}" for part, number in zip(parts, [*numbers, ""], strict=True))
            shapes[key] = torch.empty(shape, device="meta")
    return shapes


def _numbers(indices: Any) -> Iterator[int]:
    if isinstance(indices, str):
        first, last = map(int, indices.split("-"))
        yield from range(first, last + 1)
    else:
        yield from indices


def tiny_shapes(variant: str) -> dict[str, Tensor]:
    """The published tensors of a variant of the small network."""
    tiny = record()["tiny"]
    shapes = expanded(tiny["keys"]) | expanded(tiny["keys_beyond_global"].get(variant, ()))
    if variant == "frame":
        shapes = {key: shapes[key] for key in shapes if not key.startswith("style_aggregator.global_blocks.")}
    if variant == "demo":
        shapes |= expanded(tiny["demo_quick_inference"]["keys_beyond_main"])
    return shapes


def weights(shapes: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Hash-filled tensors of these names and shapes."""
    fill = record()["fill"]
    return fill_named(shapes, fill["rules"], fill["offset"])


def tiny_taps() -> dict[str, tuple[int, ...]]:
    """What shapes do not tell of the small network."""
    construction = record()["tiny"]["construction"]
    style = re.search(r"style_intermediate_layer_idx \[([\d, ]+)\]", construction["style_aggregator"]).group(1)
    return {"taps": tuple(construction["kept_layers"]), "style_taps": tuple(map(int, style.split(",")))}


def image(text: str) -> Tensor:
    """``IMG(index, shape)``."""
    index, shape = re.fullmatch(r"IMG\((\d+),\[(.*)\]\)", text).groups()
    return smooth_image(int(index), [int(length) for length in shape.split(",")])
