"""Compiled kernels by themselves."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from anystyle.compiled import compiled
from anystyle_cpu_renderer import raster


def test_compiles_where_nothing_can_be_written() -> None:
    """A function for which numba finds no folder to keep machine code in, as in an installation nobody can write."""
    namespace: dict[str, Any] = {}
    exec(compile("def double(x):\n    return 2 * x\n", "/nowhere/kernel.py", "exec"), namespace)
    with pytest.raises(RuntimeError, match="no locator"):
        njit(cache=True)(namespace["double"])
    assert compiled(namespace["double"])(21) == 42


def test_falloff_is_exp() -> None:
    sigma = np.concatenate([np.linspace(0, 6, 5001), np.linspace(6, 80, 500)]).astype(np.float32)
    actual = np.array([raster.falloff(value) for value in sigma], np.float64)
    np.testing.assert_allclose(actual, np.exp(-sigma.astype(np.float64)), rtol=4e-6)
    np.testing.assert_allclose(actual[:5001], np.exp(-sigma[:5001].astype(np.float64)), rtol=8e-7)
    assert raster.falloff(np.float32(np.inf)) < 1e-30


def test_sorting_is_stable() -> None:
    rng = np.random.default_rng(0)
    depths = np.exp(rng.normal(size=5000) * 10).round(3).astype(np.float32) + np.float32(1e-10)
    assert np.array_equal(raster.nearest_first(depths), np.argsort(depths, kind="stable"))


def test_tiles_list_the_splats_that_they_show_and_no_others() -> None:
    """Every pixel that an ellipse covers is in the rows that its tile lists for it."""
    rng = np.random.default_rng(0)
    width, height = 40, raster.HEIGHT - 5
    axes, turn = rng.uniform(0.4, 6, (60, 2)), rng.uniform(0, np.pi, 60)
    turned = np.stack([np.cos(turn), -np.sin(turn), np.sin(turn), np.cos(turn)], 1).reshape(60, 2, 2)
    shape = turned @ (axes[..., None] ** 2 * turned.transpose(0, 2, 1))
    xx, xy, yy = shape[:, 0, 0], shape[:, 0, 1], shape[:, 1, 1]
    root = np.sqrt(xx * yy - xy**2)
    center = rng.uniform(-4, [width + 4, height + 4], (60, 2))
    splats = np.zeros((60, 16), np.float32)
    splats[:, :2], splats[:, 10], splats[:, 11] = center, np.sqrt(xx), np.sqrt(yy)
    splats[:, 12], splats[:, 13], splats[:, 14] = xy / np.sqrt(yy), xy / xx, root / xx
    offsets = np.empty(-(-width // raster.WIDTH) + 1, np.int64)
    splats[:, 9] = np.sort(rng.uniform(1, 2, 60))
    lists = raster.tiles_of(splats, 0, height - 1, width, offsets)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height), indexing="xy"), -1) + 0.5
    away = pixels - center[:, None, None]
    covered = np.einsum("nhwi,nij,nhwj->nhw", away, np.linalg.inv(shape), away) <= 1
    listed = np.zeros_like(covered)
    for column in range(len(offsets) - 1):
        rows = lists[offsets[column] : offsets[column + 1]]
        assert (np.diff(rows[:, 0]) > 0).all() and (rows[:, 2] >= rows[:, 1]).all()
        for splat, first, stop in rows:
            listed[splat, first:stop, column * raster.WIDTH : (column + 1) * raster.WIDTH] = True
    assert not (covered & ~listed).any()
    assert listed.any((1, 2)).sum() <= covered.any((1, 2)).sum() + 6  # those that pass between centres of pixels
