"""The goldens of WorldMirror: its weights, inputs and outputs in our types."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import torch
from torch import Tensor

from anystyle.geometry.harmonics import CONSTANT
from anystyle.testing.oracle import fill_named, smooth_image
from anystyle.types import Attributes, Cameras, Views
from tests.support.oracle import expanded, golden

TINY: dict[str, Any] = {
    "native_resolution": 70,
    "dim": 64,
    "embed_depth": 2,
    "depth": 6,
    "heads": 4,
    "taps": (1, 3, 4, 5),
    "camera_depth": 2,
    "camera_heads": 4,
    "depth_features": 32,
    "depth_channels": (8, 12, 16, 16),
    "gaussian_features": 32,
    "gaussian_channels": (8, 12, 16, 16),
    "gaussian_hidden": 32,
    "voxel_size": 0.05,
}


@cache
def record() -> dict[str, Any]:
    return golden("golden_worldmirror")


def shapes(network: str) -> dict[str, Tensor]:
    """Tensors without values under the published names."""
    return expanded(record()[network]["keys"])


@cache
def tiny_weights() -> dict[str, Tensor]:
    return fill_named(shapes("tiny"), record()["fill"]["rules"])


def views(case: Mapping[str, Any]) -> Views:
    """The photographs of a case, and its cameras where it has them."""
    images = smooth_image(*case["images"])
    if "camera_poses" not in case:
        return Views(images)
    poses, lenses = torch.tensor(case["camera_poses"]), torch.tensor(case["camera_intrs"])
    return Views(images, Cameras(poses, lenses, (images.shape[-2], images.shape[-1])))


def raw_maps(attributes: Attributes, images: Tensor) -> Tensor:
    """Attributes that are not fused as the published head lays them out, B V H W 12."""
    assert attributes.confidence is not None
    added = attributes.color[..., 0] - (images.movedim(2, -1) - 0.5) / CONSTANT
    single = (attributes.opacity[..., None], attributes.confidence[..., None])
    return torch.cat([attributes.rotation, attributes.scale, single[0], added, single[1]], dim=-1)
