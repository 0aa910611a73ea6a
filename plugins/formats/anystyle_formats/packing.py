"""Numbers in few bits, and an order in which they compress well."""

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


def morton_order(points: Float[np.ndarray, "N 3"]) -> NDArray[np.int64]:
    """An order in which neighbours in space are neighbours in the file, which packs better."""
    low, high = points.min(0, initial=0.0), points.max(0, initial=0.0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")
