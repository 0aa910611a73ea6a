"""The goldens of Stylos: its tensors and weights."""

import itertools
import re
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named
from tests.support.oracle import golden


@cache
def record() -> dict[str, Any]:
    return golden("golden_stylos")


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
