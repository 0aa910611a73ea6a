"""The goldens of MapAnything: its weights and inputs in our types."""

from functools import cache
from typing import Any

from torch import Tensor

from anystyle.testing.oracle import fill_named
from tests.support.oracle import expanded, golden

TINY: dict[str, Any] = {
    "native_resolution": 70,
    "dim": 64,
    "embed_depth": 3,
    "depth": 6,
    "heads": 4,
    "taps": (-1, 2, 3, 5),
    "depth_features": 32,
    "depth_channels": (8, 12, 16, 24),
    "depth_hidden": 16,
    "gaussian_features": 32,
    "gaussian_channels": (8, 12, 16, 24),
    "gaussian_hidden": 16,
}


@cache
def record() -> dict[str, Any]:
    return golden("golden_mapanything")


def shapes(network: str) -> dict[str, Tensor]:
    """Tensors without values under the published names."""
    return expanded(record()[network]["keys"])


@cache
def tiny_weights() -> dict[str, Tensor]:
    return fill_named(shapes("tiny"), record()["fill"]["rules"])
