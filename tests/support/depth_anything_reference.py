"""The goldens of Depth Anything 3: its weights, inputs and outputs in our types."""

from collections.abc import Mapping
from functools import cache
from typing import Any

import torch
from torch import Tensor

from anystyle.testing.oracle import fill_named
from anystyle.types import Attributes, Cameras, Gaussians
from tests.support.oracle import golden

TINY: dict[str, Any] = {
    "native_resolution": 70,
    "dim": 64,
    "depth": 10,
    "heads": 4,
    "alternate_from": 3,
    "taps": (3, 5, 7, 9),
    "depth_features": 32,
    "depth_channels": (8, 12, 16, 16),
    "gaussian_features": 32,
    "gaussian_channels": (8, 12, 16, 16),
}


@cache
def record() -> dict[str, Any]:
    return golden("golden_da3")


def weights(shapes: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The goldens' weights under their published names."""
    return fill_named(shapes, record()["fill"]["rules"])


@cache
def tiny_weights() -> dict[str, Tensor]:
    return weights({name: torch.empty(shape) for name, shape in record()["tiny"]["keys"].items()})


def check_cameras(actual: Cameras, expected: Mapping[str, Any]) -> None:
    motions = actual.camera_from_world[..., :3, :].flatten(0, 1).flatten(1)
    torch.testing.assert_close(motions, torch.tensor(expected["extrinsics_w2c_3x4"]), rtol=1e-4, atol=1e-5)
    lenses = actual.intrinsics.flatten(0, 1).flatten(1)
    torch.testing.assert_close(lenses, torch.tensor(expected["intrinsics_px"]), rtol=1e-4, atol=1e-4)


def raw_maps(attributes: Attributes) -> Tensor:
    """Attributes in the order of the published head's channels, without opacity."""
    offset = attributes.offset
    assert offset is not None
    parts = [offset[..., :2], attributes.scale, attributes.rotation, attributes.color.flatten(4), offset[..., 2:]]
    return torch.cat(parts, dim=-1)


def check_gaussians(actual: Gaussians, expected: Mapping[str, Any]) -> None:
    """All samples, and the means and root mean squares over all Gaussians of the first scene."""
    assert actual.means.shape[1] == expected["N"]
    colors = actual.harmonics.mT.flatten(2)
    for sample in expected["samples"]:
        at = sample["index"]
        turn = torch.tensor(sample["rotation"])
        rotation = actual.rotations[0, at]
        if abs(turn[3]) < 1e-3:  # where the sign is a matter of rounding
            rotation = rotation * torch.sign(rotation @ turn)
        found = [actual.means[0, at], actual.scales[0, at], rotation, actual.opacities[0, at], colors[0, at]]
        # Published scales are negative behind the camera.
        size = torch.tensor(sample["scale"]).abs()
        wanted = [sample["mean"], size, turn, sample["opacity"], sample["harmonics"]]
        for one, other in zip(found, wanted, strict=True):
            torch.testing.assert_close(one, torch.as_tensor(other), rtol=2e-4, atol=2e-5)
    # Not the means of scales and rotations: signs differ.
    for name, values in (("means", actual.means), ("harmonics", colors), ("opacities", actual.opacities[..., None])):
        moments = expected["stats"][name]
        flat = values.flatten(0, 1)
        torch.testing.assert_close(flat.mean(0), torch.tensor(moments["mean"]), rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(flat.square().mean(0).sqrt(), torch.tensor(moments["rms"]), rtol=1e-4, atol=1e-6)
