"""Depths by stereo in exact pictures of a known world."""

import os
import subprocess
import sys

import numpy as np
import torch
from scipy.ndimage import uniform_filter

from anystyle_captures.stereo import plane_sweep
from anystyle_captures.stereo_kernels import NOISE, SIDE, sweep, warp
from tests.support.cards import photographed


def test_what_is_near_is_found_though_no_point_lies_on_it():
    """Cards before the wall, which alone has known points, at depths of 4.6 to 5.7."""
    images, cameras = photographed(7)
    side = torch.linspace(-1, 1, 6)
    points = [torch.cartesian_prod(side, side, torch.tensor([2.5]))] * 7
    found = plane_sweep(images, cameras, points=points)
    assert ((found.depth < 0.6 * 4.6) & (found.support > 1)).double().mean() > 0.05
    # Where no depth agrees, the points are all that is known.
    assert plane_sweep(torch.full_like(images, 0.5), cameras, points=points).depth.isfinite().all()


def test_a_pixel_that_a_homography_takes_to_no_number_is_outside():
    homography = np.array([[1, 0, -0.5], [0, 1, -0.5], [1, 0, -0.5]])  # the first pixel to 0 / 0
    warped, inside = np.empty((9, 12), np.float32), np.empty((9, 12), np.bool_)
    warp(np.full((9, 12), 0.5, np.float32), homography, warped, inside)
    assert (warped == 0.5).all() and not inside[:, 0].any()


def test_costs_of_planes_are_those_of_windows_by_scipy():
    """Of three sources the two that are most alike count."""
    images = np.random.default_rng(0).random((4, 24, 30)).astype(np.float32)
    mean, square, both = uniform_filter([images, images**2, images * images[0]], SIDE, mode="nearest", axes=(2, 3))
    variance, costs = square - mean**2, np.empty((24, 30, 1), np.float32)
    expected = 1 - (both - mean * mean[0]) / np.sqrt((variance + NOISE) * (variance[0] + NOISE))
    sweep(images[0], mean[0], variance[0], images[1:], np.tile(np.eye(3), (3, 1, 1, 1)), costs)
    np.testing.assert_allclose(costs[..., 0], np.sort(expected[1:].clip(0, 1), 0)[:2].mean(0), atol=1e-4)


def test_the_process_that_compiles_kernels_computes_what_those_do_that_load_them(tmp_path):
    lines = """import numpy as np
from anystyle_captures.stereo_kernels import sweep
images, costs = np.random.default_rng(0).random((4, 60, 80), np.float32), np.empty((60, 80, 1), np.float32)
sweep(*images[:3], images[1:], np.tile(np.eye(3) + 0.01, (3, 1, 1, 1)), costs)
print(costs.tobytes().hex())"""
    command, kept = [sys.executable, "-c", lines], os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    first, later = (subprocess.run(command, env=kept, check=True, capture_output=True).stdout for _ in range(2))
    assert first == later
