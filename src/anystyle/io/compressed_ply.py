"""Compressed PLY, as SuperSplat and splat-transform write it: 16 bytes a Gaussian, in chunks of 256.

The format is described in PlayCanvas's user manual (developer.playcanvas.com, "The Compressed PLY format").
"""

from math import sqrt

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from plyfile import PlyData

from anystyle.io.packing import smallest_three_to_wxyz

CHUNK = 256
"""Gaussians that one row of bounds is for."""

_CONSTANT = 0.5 / sqrt(np.pi)
_BYTE_BOUNDS = 8.0


def unpack(data: PlyData) -> dict[str, Float[np.ndarray, " N"]]:
    """The properties of an ordinary PLY file of Gaussians, by name.

    Raises:
        ValueError: Chunks are missing.
        KeyError: Elements or properties are missing.
    """
    vertex, chunk = data["vertex"].data, data["chunk"].data
    if len(chunk) * CHUNK < len(vertex):
        raise ValueError(f"{len(chunk)} chunks for {len(vertex)} Gaussians; {CHUNK} a chunk are expected")
    rows = np.arange(len(vertex)) // CHUNK

    def between(values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        low, high = (chunk[f"{bound}_{name}"][rows].astype(np.float64) for bound in ("min", "max"))
        return low + (high - low) * values

    columns: dict[str, NDArray[np.float64]] = {}
    for name, axis, values in zip("xyz", ("x", "y", "z"), _bits_11_10_11(vertex["packed_position"]), strict=True):
        columns[name] = between(values, axis)
    for index, values in enumerate(_bits_11_10_11(vertex["packed_scale"])):
        columns[f"scale_{index}"] = between(values, f"scale_{'xyz'[index]}")
    quaternions = smallest_three_to_wxyz(vertex["packed_rotation"])
    columns |= {f"rot_{index}": quaternions[:, index] for index in range(4)}
    packed = vertex["packed_color"]
    red, green, blue, alpha = ((packed >> shift & 255) / 255 for shift in (24, 16, 8, 0))
    for index, (channel, values) in enumerate(zip("rgb", (red, green, blue), strict=True)):
        bounded = between(values, channel) if f"min_{channel}" in (chunk.dtype.names or ()) else values
        columns[f"f_dc_{index}"] = (bounded - 0.5) / _CONSTANT
    opacity = alpha.clip(1e-6, 1 - 1e-6)
    columns["opacity"] = np.log(opacity / (1 - opacity))
    if "sh" in data:
        for name in data["sh"].data.dtype.names or ():
            columns[name] = _coefficient(data["sh"].data[name])
    return {name: values.astype(np.float32) for name, values in columns.items()}


def _bits_11_10_11(packed: NDArray[np.uint32]) -> tuple[NDArray[np.float64], ...]:
    return (packed >> 21) / 2047, (packed >> 11 & 1023) / 1023, (packed & 2047) / 2047


def _coefficient(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Harmonics of degrees above 0 in [-4, 4]; the first and last byte are the bounds, others middles of intervals."""
    middle = (packed.astype(np.float64) + 0.5) / 256
    unit = np.where(packed == 0, 0.0, np.where(packed == 255, 1.0, middle))
    return (unit - 0.5) * _BYTE_BOUNDS
