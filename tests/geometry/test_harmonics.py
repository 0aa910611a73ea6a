"""Spherical harmonics against the published basis and scipy."""

import numpy as np
import pytest
import torch
from scipy.special import sph_harm_y
from torch.nn.functional import normalize

from anystyle.geometry.harmonics import basis, colors, degree_of, rgb_from_constant, rotate
from anystyle.geometry.transforms import matrix_from_wxyz
from tests.support.oracle import golden


def directions(count: int) -> torch.Tensor:
    return normalize(torch.randn(count, 3, generator=torch.Generator().manual_seed(0), dtype=torch.float64), dim=-1)


def test_published_basis() -> None:
    record = golden("anystyle_golden")["sh_quirk"]
    expected = torch.tensor(record["bases"], dtype=torch.float64)
    actual = basis(torch.tensor(record["dirs"], dtype=torch.float64), 4)
    torch.testing.assert_close(actual, expected, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("degree", [0, 1, 2, 3, 4, 7])
def test_scipy(degree: int) -> None:
    """The real harmonics of scipy's complex ones, with the sign of 3DGS."""
    rays = directions(40)
    polar, azimuth = rays[:, 2].acos().numpy(), torch.atan2(rays[:, 1], rays[:, 0]).numpy()
    columns = []
    for n in range(degree + 1):
        for m in range(-n, n + 1):
            complex_value = sph_harm_y(n, abs(m), polar, azimuth)  # holds the sign (-1) ** m
            columns.append((complex_value.imag if m < 0 else complex_value.real) * (np.sqrt(2) if m else 1))
    torch.testing.assert_close(basis(rays, degree), torch.from_numpy(np.stack(columns, axis=-1)))


def test_colors() -> None:
    rays = directions(20)
    harmonics = torch.randn(20, 9, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    expected = (torch.einsum("nk,nkc->nc", basis(rays, 2), harmonics) + 0.5).clamp_min(0)
    assert (expected == 0).any()
    torch.testing.assert_close(colors(harmonics, rays), expected)
    torch.testing.assert_close(colors(harmonics[:, :1], rays), rgb_from_constant(harmonics[:, 0]).clamp_min(0))


@pytest.mark.parametrize("degree", [0, 1, 4])
def test_rotation(degree: int) -> None:
    """What a turned world shows along a turned direction is what the world shows along the direction."""
    rotation = matrix_from_wxyz(torch.tensor([0.3, -0.7, 0.5, 0.4], dtype=torch.float64))
    rays = directions(15)
    harmonics = torch.randn(15, (degree + 1) ** 2, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    turned = rotate(harmonics, rotation)
    torch.testing.assert_close(colors(turned, rays @ rotation.T), colors(harmonics, rays))
    torch.testing.assert_close(rotate(turned, rotation.T), harmonics)


@pytest.mark.parametrize("coefficients", [0, 2, 24])
def test_refuses_counts_that_are_no_squares(coefficients: int) -> None:
    with pytest.raises(ValueError, match=f"{coefficients} spherical-harmonics coefficients"):
        degree_of(coefficients)
