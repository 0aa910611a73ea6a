"""The golden files: what published implementations compute on weights and inputs filled by a hash.

Each file's ``_about`` states the rule in words; see :mod:`anystyle.testing.oracle`.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import assert_matches, bounds, hashed

GOLDENS = Path(__file__).parents[1] / "goldens"


def golden(name: str) -> dict[str, Any]:
    """One file of ``tests/goldens``."""
    return json.loads((GOLDENS / f"{name}.json").read_text())


def expanded(keys: Mapping[str, Sequence[int]]) -> dict[str, Tensor]:
    """Tensors without values under the published names; ``{0..5}`` in a name stands for numbers."""
    written: dict[str, Tensor] = {}
    for name, shape in keys.items():
        first, last = map(int, found.groups()) if (found := re.search(r"\{(\d+)\.\.(\d+)\}", name)) else (0, 0)
        for number in range(first, last + 1):
            written[re.sub(r"\{.*\}", str(number), name)] = torch.empty(tuple(shape), device="meta")
    return written


def check(actual: Tensor, expected: Mapping[str, Any]) -> None:
    """Within the tolerance of goldens of networks: 2e-4 of the root mean square, and 1e-4 of the value."""
    count = torch.tensor(expected["shape"]).prod().item()
    assert_matches(actual, expected, atol=2e-4 * expected["l2"] / count**0.5)


def fill_sorted(shapes: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Fill rule 1 (``anystyle_golden.json``): the hash index is the place of the reference key among the sorted."""
    filled: dict[str, Tensor] = {}
    for place, key in enumerate(sorted(shapes), start=1):
        like = shapes[key]
        if not like.is_floating_point():
            filled[key] = torch.zeros(like.shape, dtype=like.dtype)
            continue
        low, high = bounds(key, like.shape)
        filled[key] = hashed(place, like.shape, low, high)
    return filled
