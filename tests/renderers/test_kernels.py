"""Compiled kernels by themselves."""

from typing import Any

import numpy as np
import pytest
from numba import njit

from anystyle.renderers.cpu import raster, sorting
from anystyle.renderers.cpu.compiled import compiled


def function_without_a_file() -> Any:
    """A function for which numba finds no folder to keep machine code in, as in an installation nobody can write."""
    namespace: dict[str, Any] = {}
    exec(compile("def double(x):\n    return 2 * x\n", "/nowhere/kernel.py", "exec"), namespace)
    return namespace["double"]


def test_compiles_where_nothing_can_be_written() -> None:
    with pytest.raises(RuntimeError, match="no locator"):
        njit(cache=True)(function_without_a_file())
    assert compiled(function_without_a_file())(21) == 42


def test_falloff_is_exp() -> None:
    sigma = np.concatenate([np.linspace(0, 6, 5001), np.linspace(6, 80, 500)]).astype(np.float32)
    actual = np.array([raster.falloff(value) for value in sigma], np.float64)
    np.testing.assert_allclose(actual, np.exp(-sigma.astype(np.float64)), rtol=4e-6)
    np.testing.assert_allclose(actual[:5001], np.exp(-sigma[:5001].astype(np.float64)), rtol=8e-7)
    assert raster.falloff(np.float32(np.inf)) < 1e-30


def test_sorting_is_stable() -> None:
    rng = np.random.default_rng(0)
    splats = np.zeros((5000, 12), np.float32)
    splats[:, 9] = np.exp(rng.normal(size=5000) * 10).round(3) + np.float32(1e-10)
    rows = np.flatnonzero(rng.random(5000) < 0.7)
    order = sorting.nearest_first(splats, rows)
    assert np.array_equal(order, np.argsort(splats[rows, 9], kind="stable"))
