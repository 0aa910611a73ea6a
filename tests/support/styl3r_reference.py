"""The goldens of Styl3R: its weights, inputs and outputs in our types."""

import re
from collections.abc import Mapping
from functools import cache
from itertools import product
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named, hashed
from anystyle.types import Cameras
from tests.support.oracle import golden

DIMS = {"dim": 64, "depth": 3, "heads": 4}
TINY: dict[str, Any] = {
    **DIMS,
    "decoder_dim": 48,
    "decoder_depth": 10,
    "decoder_heads": 4,
    "features": 16,
    "channels": (8, 12, 16, 20),
    "hidden": 8,
    "sh_degree": 1,
}


@cache
def record() -> dict[str, Any]:
    return golden("golden_styl3r")


def expanded(pattern: str) -> list[str]:
    """A pattern of bash's brace expansion, without nesting."""
    parts = []
    for literal, braces in re.findall(r"([^{}]+)|\{([^}]*)\}", pattern):
        if numbers := re.fullmatch(r"(\d+)\.\.(\d+)", braces):
            parts.append([str(number) for number in range(int(numbers[1]), int(numbers[2]) + 1)])
        else:
            parts.append(braces.split(",") if braces else [literal])
    return ["".join(chosen) for chosen in product(*parts)]


def shapes(network: str) -> dict[str, list[int]]:
    """The shapes of a network's tensors under their published names."""
    return {name: shape for pattern, shape in record()[network]["keys"].items() for name in expanded(pattern)}


def weights(shapes: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The goldens' weights under their published names; aliases are filled by the name of the tensor they stand for."""
    fill = record()["fill"]
    own = {name: like for name, like in shapes.items() if ".layer_rn." not in name}
    state = fill_named(own, fill["rules"], fill["offset"])
    for name in shapes.keys() - own.keys():
        match = re.fullmatch(r"(.*)layer_rn\.(\d)\.weight", name)
        state[name] = state[f"{match[1]}layer{int(match[2]) + 1}_rn.weight"]
    return state


@cache
def tiny_weights() -> dict[str, Tensor]:
    return weights({name: torch.empty(shape, device="meta") for name, shape in shapes("tiny").items()})


def lenses(text: str) -> Tensor:
    """Intrinsics in units of the image."""
    index, shape = re.fullmatch(r"K\((\d+), ?\[(.*)\]\)", text).groups()
    ranges = ((0.7, 1.3), (0.8, 1.5), (0.45, 0.55), (0.45, 0.55))
    given = [int(length) for length in shape.split(",")]
    fx, fy, cx, cy = (hashed(int(index) + place, given, *ends) for place, ends in enumerate(ranges))
    zero, one = torch.zeros_like(fx), torch.ones_like(fx)
    return torch.stack([fx, zero, cx, zero, fy, cy, zero, zero, one], dim=-1).unflatten(-1, (3, 3))


def cameras(inputs: Mapping[str, str], size: tuple[int, int]) -> Cameras:
    units = lenses(inputs["intrinsics"])
    return Cameras(torch.eye(4).expand(*units.shape[:2], 4, 4), units, (1, 1)).resized(size)
