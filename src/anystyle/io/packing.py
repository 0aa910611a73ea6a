"""Numbers in few bits, as compact formats of Gaussians keep them."""

from math import sqrt

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray


def smallest_three(wxyz: Float[np.ndarray, "N 4"]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Of each unit quaternion the index of its largest component, and the other three in order, in ±1/√2.

    The quaternion's sign is the one that makes the largest component positive.
    """
    largest = np.abs(wxyz).argmax(1)
    signs = np.where(np.take_along_axis(wxyz, largest[:, None], 1) < 0, -1.0, 1.0)
    kept = np.arange(4) != largest[:, None]
    return largest, (wxyz * signs)[kept].reshape(-1, 3)


def from_smallest_three(largest: NDArray[np.int64], others: NDArray[np.float64]) -> Float[np.ndarray, "N 4"]:
    """The inverse of :func:`smallest_three`."""
    quaternions = np.empty((len(largest), 4))
    kept = np.arange(4) != largest[:, None]
    quaternions[kept] = others.ravel()
    quaternions[~kept] = np.sqrt((1 - np.square(others).sum(1)).clip(0))
    return quaternions


def smallest_three_to_wxyz(packed: NDArray[np.uint32]) -> Float[np.ndarray, "N 4"]:
    """Quaternions of 2 + 3 x 10 bits: the index of the largest of wxyz, then the others as fractions of ±1/√2."""
    fractions = np.stack([packed >> shift & 1023 for shift in (20, 10, 0)], 1) / 1023
    return from_smallest_three((packed >> 30).astype(np.int64), (fractions - 0.5) * sqrt(2))


def morton_order(points: Float[np.ndarray, "N 3"]) -> NDArray[np.int64]:
    """An order in which neighbours in space are neighbours in the file, which packs better."""
    low, high = points.min(0, initial=0.0), points.max(0, initial=0.0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")
