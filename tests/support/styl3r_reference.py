"""The goldens of Styl3R: its weights, inputs and outputs in our types."""

import re
from collections.abc import Iterable, Mapping
from functools import cache
from itertools import product
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named, hashed, smooth_image
from anystyle.types import Cameras, Tokens
from tests.support.oracle import golden

NAME = "golden_styl3r"
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
    return golden(NAME)


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
    patterns = record()[network]["keys"].items()
    return {name: shape for pattern, shape in patterns for name in expanded(pattern)}


def weights(shapes: Mapping[str, Tensor], names: Iterable[str] = ()) -> dict[str, Tensor]:
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


def picture(text: str) -> Tensor:
    index, shape = re.fullmatch(r"IMG\((\d+), ?\[(.*)\]\)", text).groups()
    return smooth_image(int(index), [int(length) for length in shape.split(",")])


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


def in_their_order(tokens: Tokens) -> Tensor:
    """Tokens with the special one last, as published."""
    return tokens.data.roll(-tokens.special, dims=2)


WORST: dict[str, float] = {}
"""The largest errors seen, in units of what is tolerated, by record."""


def check(actual: Tensor, expected: Mapping[str, Any], name: str = "") -> None:
    """Within the golden's own tolerance: 2e-4 of the root mean square and 1e-4 of the value; covariances 1e-4."""
    assert list(actual.shape) == expected["shape"], name
    flat = actual.detach().double().flatten()
    wanted = torch.tensor(expected["val"], dtype=torch.float64)
    rms = expected["l2"] / flat.numel() ** 0.5
    atol = 1e-4 * expected["max"] if name == "covariances" else 2e-4 * rms
    error = (flat[torch.tensor(expected["idx"])] - wanted).abs() / (atol + 1e-4 * wanted.abs())
    parts = {
        "samples": error.max().item(),
        "l2": abs(flat.norm().item() / expected["l2"] - 1) / 1e-4,
        "abs_mean": abs(flat.abs().mean().item() / expected["abs_mean"] - 1) / 1e-4,
        "sum": abs(flat.sum().item() - expected["sum"]) / (1e-4 * expected["abs_mean"] * flat.numel()),
    }
    WORST[name] = max(WORST.get(name, 0.0), *parts.values())
    assert max(parts.values()) <= 1, f"{name}: {parts}"
