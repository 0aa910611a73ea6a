"""The golden files: what published implementations compute on weights and inputs filled by a hash.

Each file's ``_about`` states the rule in words; see :mod:`anystyle.testing.oracle`.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import bounds, hashed

GOLDENS = Path(__file__).parents[1] / "goldens"


def golden(name: str) -> dict[str, Any]:
    """One file of ``tests/goldens``."""
    return json.loads((GOLDENS / f"{name}.json").read_text())


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
