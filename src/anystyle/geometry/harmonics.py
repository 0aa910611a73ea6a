"""Real spherical harmonics in the order and with the signs of 3DGS.

Coefficient ``l * l + l + m`` has degree ``l`` and order ``m`` in ``-l .. l``; the sign is ``(-1) ** m`` times that of
the real harmonics of mathematics, so that the three of degree 1 are ``-y, z, -x`` times 0.4886.
"""

from functools import cache
from math import factorial, isqrt, pi, sqrt

import torch
from jaxtyping import Float
from torch import Tensor

CONSTANT = 0.5 / sqrt(pi)
"""The harmonic of degree 0."""


def degree_of(coefficients: int) -> int:
    """The degree of harmonics with a number of coefficients, which must be a square.

    Example:
        >>> degree_of(16)
        3
    """
    degree = isqrt(max(coefficients, 1)) - 1
    if (degree + 1) ** 2 != coefficients:
        raise ValueError(f"{coefficients} spherical-harmonics coefficients; expected (degree + 1)², such as 4, 9 or 16")
    return degree


def basis(directions: Float[Tensor, "*batch 3"], degree: int) -> Float[Tensor, "*batch K"]:
    """The ``(degree + 1)²`` harmonics at unit vectors.

    With ``P`` the associated Legendre polynomials divided by ``sin(theta) ** m`` (Sloan, Efficient Spherical Harmonic
    Evaluation, 2013), the harmonics are ``P(z)`` times the real and imaginary parts of ``(x + iy) ** m``.
    """
    x, y, z = directions.unbind(-1)
    legendre = _legendre(z, degree)
    cosine, sine = torch.ones_like(x), torch.zeros_like(x)  # parts of (x + iy) ** m
    values: dict[int, Tensor] = {}
    for m in range(degree + 1):
        for l in range(m, degree + 1):  # noqa: E741
            scale = normalisation(l, m)
            values[l * l + l + m] = scale * legendre[l, m] * cosine
            values[l * l + l - m] = scale * legendre[l, m] * (sine if m else cosine)
        cosine, sine = x * cosine - y * sine, x * sine + y * cosine
    return torch.stack([values[k] for k in range((degree + 1) ** 2)], dim=-1)


def normalisation(degree: int, order: int) -> float:
    """The factor that gives the harmonic of a degree and an order of at least 0 unit norm on the sphere, signed."""
    ratio = factorial(degree - order) / factorial(degree + order)
    return (-1) ** order * sqrt((2 if order else 1) * (2 * degree + 1) / (4 * pi) * ratio)


def _legendre(z: Tensor, degree: int) -> dict[tuple[int, int], Tensor]:
    polynomials = {(0, 0): torch.ones_like(z)}
    for m in range(degree + 1):
        if m:
            polynomials[m, m] = (2 * m - 1) * polynomials[m - 1, m - 1]
        for l in range(m + 1, degree + 1):  # noqa: E741
            below = polynomials.get((l - 2, m), torch.zeros_like(z))
            polynomials[l, m] = ((2 * l - 1) * z * polynomials[l - 1, m] - (l + m - 1) * below) / (l - m)
    return polynomials


def colors(harmonics: Float[Tensor, "*batch K 3"], directions: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The colours that 3DGS shows along unit vectors: ``max(sum_k Y_k harmonics_k + 0.5, 0)``."""
    degree = degree_of(harmonics.shape[-2])
    if degree == 0:
        return rgb_from_constant(harmonics[..., 0, :]).clamp_min(0)
    return ((basis(directions, degree)[..., None] * harmonics).sum(-2) + 0.5).clamp_min(0)


def constant_from_rgb(rgb: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The coefficients of degree 0 that show a colour in [0, 1].

    Example:
        >>> orange = constant_from_rgb(torch.tensor([1.0, 0.5, 0.0]))
        >>> orange
        tensor([ 1.7725,  0.0000, -1.7725])
        >>> colors(orange[None], torch.tensor([0.0, 0.0, 1.0]))
        tensor([1.0000, 0.5000, 0.0000])
    """
    return (rgb - 0.5) / CONSTANT


def rgb_from_constant(constant: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
    """The colour that coefficients of degree 0 show, below 0 not yet cut."""
    return (constant * CONSTANT).add_(0.5)


def damping(degree: int) -> list[float]:
    """AnySplat's factor for each coefficient up to ``degree``: 1, and ``0.1 * 0.25 ** d`` for degree d > 0."""
    return [1.0] + [0.1 * 0.25**d for d in range(1, degree + 1) for _ in range(2 * d + 1)]


def rotate(harmonics: Float[Tensor, "*batch K 3"], rotation: Float[Tensor, "3 3"]) -> Float[Tensor, "*batch K 3"]:
    """The coefficients of the same colours after a rotation of the world."""
    matrix = rotation_matrices(rotation, degree_of(harmonics.shape[-2]))
    return torch.einsum("kj,...jc->...kc", matrix.to(harmonics.dtype), harmonics)


def rotation_matrices(rotations: Float[Tensor, "*batch 3 3"], degree: int) -> Float[Tensor, "*batch K K"]:
    """Matrices that rotate coefficients; they mix harmonics of one degree.

    They are the least-squares fit of the values of the harmonics at more directions than there are coefficients.
    """
    directions, inverse = (part.to(rotations.device) for part in _fit(degree))
    original = basis(directions @ rotations.double(), degree)  # ... M K, in the axes before the rotation
    degrees = torch.arange((degree + 1) ** 2, device=rotations.device).sqrt().floor()  # degree of each coefficient
    return (inverse @ original * (degrees[:, None] == degrees)).to(rotations.dtype)


@cache
def _fit(degree: int) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "K M"]]:
    """Unit vectors on a Fibonacci spiral, and the pseudo-inverse of the harmonics there."""
    count = 8 * (degree + 1) ** 2
    index = torch.arange(count, dtype=torch.float64, device="cpu") + 0.5
    z = 1 - 2 * index / count
    angle, radius = index * (pi * (3 - 5**0.5)), (1 - z * z).sqrt()
    directions = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=-1)
    return directions, torch.linalg.pinv(basis(directions, degree))
