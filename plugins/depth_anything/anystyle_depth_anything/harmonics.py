"""Spherical harmonics of many cameras, turned into the world."""

from functools import cache
from math import pi

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.harmonics import basis


def damping(degree: int) -> list[float]:
    """A factor for each coefficient up to ``degree``: 1, and ``0.1 * 0.25 ** d`` for degree d > 0."""
    return [1.0] + [0.1 * 0.25**d for d in range(1, degree + 1) for _ in range(2 * d + 1)]


def turning(rotations: Float[Tensor, "*batch 3 3"], degree: int) -> Float[Tensor, "*batch K K"]:
    """Matrices that turn coefficients from camera to world: those of one degree turn among themselves.

    They follow from the values of the harmonics at more directions than there are harmonics.
    """
    directions, inverse = (part.to(rotations.device) for part in _probe(degree))
    seen = basis(directions @ rotations.double(), degree)  # ... M K, in the axes of the camera
    degrees = torch.arange((degree + 1) ** 2, device=rotations.device).sqrt().floor()  # degree of each coefficient
    return (inverse @ seen * (degrees[:, None] == degrees)).to(rotations.dtype)


@cache
def _probe(degree: int) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "K M"]]:
    """Unit vectors on a Fibonacci spiral, and what gives coefficients from values there."""
    count = 8 * (degree + 1) ** 2
    index = torch.arange(count, dtype=torch.float64, device="cpu") + 0.5
    z = 1 - 2 * index / count
    angle, radius = index * (pi * (3 - 5**0.5)), (1 - z * z).sqrt()
    directions = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=-1)
    return directions, torch.linalg.pinv(basis(directions, degree))
