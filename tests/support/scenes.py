"""Random scenes for the tests of renderers."""

from importlib.util import find_spec

import pytest
import torch
from torch import Tensor

from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians

warp = pytest.param(
    catalog().find("renderer", "warp").load(),
    marks=pytest.mark.skipif(find_spec("warp") is None, reason="warp-lang is not installed"),
)
"""The renderer of cards without a compiler, whose kernels run on the CPU, too."""


def gaussians(batch: int, number: int, degree: int = 0, seed: int = 0, dtype: torch.dtype = torch.float32) -> Gaussians:
    """Gaussians in the cube of side 2 around the origin."""
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, low: float, high: float) -> Tensor:
        return low + (high - low) * torch.rand(*shape, generator=generator, dtype=torch.float64)

    return Gaussians(
        means=uniform(batch, number, 3, low=-1, high=1),
        rotations=uniform(batch, number, 4, low=-1, high=1),
        scales=uniform(batch, number, 3, low=-3.5, high=-1.5).exp(),
        opacities=uniform(batch, number, low=0.05, high=1),
        harmonics=uniform(batch, number, (degree + 1) ** 2, 3, low=-0.5, high=0.5),
    ).to(dtype)


def cameras(
    batch: int,
    views: int,
    size: tuple[int, int],
    seed: int = 1,
    distance: float = 3.0,
    dtype: torch.dtype = torch.float32,
) -> Cameras:
    """Cameras around the origin that look at it, each with its own intrinsics."""
    generator = torch.Generator().manual_seed(seed)
    quaternions = torch.randn(batch, views, 4, generator=generator, dtype=torch.float64)
    pose = torch.eye(4, dtype=torch.float64).repeat(batch, views, 1, 1)
    pose[..., :3, :3] = matrix_from_wxyz(quaternions)
    pose[..., :3, 3] = -distance * pose[..., :3, 2]
    height, width = size
    intrinsics = torch.eye(3, dtype=torch.float64).repeat(batch, views, 1, 1)
    jitter = 0.9 + 0.2 * torch.rand(batch, views, 4, generator=generator, dtype=torch.float64)
    intrinsics[..., 0, 0] = 1.1 * width * jitter[..., 0]
    intrinsics[..., 1, 1] = 1.1 * height * jitter[..., 1]
    intrinsics[..., 0, 2] = 0.5 * width * jitter[..., 2]
    intrinsics[..., 1, 2] = 0.5 * height * jitter[..., 3]
    return Cameras(pose, intrinsics, size).to(dtype)
