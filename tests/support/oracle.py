"""The golden files: what published implementations compute on weights and inputs filled by a hash.

Each file's ``_about`` states the rule in words; see :mod:`anystyle.testing.oracle`.
"""

import gzip
import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from anystyle.testing.oracle import assert_matches, bounds, hashed, smooth_image

GOLDENS = Path(__file__).parents[1] / "goldens"


def golden(name: str) -> dict[str, Any]:
    """One file of ``tests/goldens``."""
    return json.loads(gzip.decompress((GOLDENS / f"{name}.json.gz").read_bytes()))


def image(text: str) -> Tensor:
    """The pictures that goldens write as ``IMG(index, [shape])``."""
    index, shape = re.search(r"IMG\((\d+), ?\[([\d,]+)\]\)", text).groups()
    return smooth_image(int(index), [int(length) for length in shape.split(",")])


def stripes_and_rings(side: int, phase: float) -> Tensor:
    """A picture in closed form, (1, 3, side, side) in [0, 1]."""
    y, x = np.meshgrid(np.linspace(-1, 1, side), np.linspace(-1, 1, side), indexing="ij")
    radius = np.hypot(x - 0.2, y + 0.1)
    waves = [np.sin(9 * x + 5 * y + phase), np.sin(14 * radius + 2 * phase), np.sin(7 * x * y - 3 * y + 3 * phase)]
    return torch.from_numpy((0.5 + 0.5 * np.stack(waves)).astype(np.float32))[None]


def tolerance(expected: Mapping[str, Any]) -> float:
    """The absolute tolerance of goldens of networks: 2e-4 of the root mean square."""
    return 2e-4 * expected["l2"] / math.prod(expected["shape"]) ** 0.5


def check(actual: Tensor, expected: Mapping[str, Any], name: str = "") -> None:
    """Within the tolerance of goldens of networks and 1e-4 of the value; covariances 1e-4 of the largest."""
    atol = 1e-4 * expected["max"] if name == "covariances" else tolerance(expected)
    try:
        assert_matches(actual, expected, atol=atol)
    except AssertionError as error:
        raise AssertionError(f"{name}: {error}") from None
    if "sum" in expected:
        total = actual.detach().double().sum().item()
        assert abs(total - expected["sum"]) <= 1e-4 * expected["abs_mean"] * actual.numel(), name


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
