"""SPZ, version 3, as described at github.com/nianticlabs/spz: the newest version without Zstandard.

Its axes are right, up, back. It has no field for notes.
"""

import gzip
import struct
from math import floor, isqrt, log2, sqrt
from pathlib import Path

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.io.ply import MAX_DEGREE
from anystyle.types import StyledScene
from anystyle_formats.packing import smallest_three

MAGIC, VERSION = 0x5053474E, 3
MAX_FRACTION_BITS = 18
"""Fractional bits of a fixed-point coordinate; large scenes get fewer."""
_COLOR_SCALE = 0.15


class Spz(Format):
    """SPZ, as Niantic publishes it: compressed to about a tenth of a PLY file."""

    up = "y"

    def write(self, scene: StyledScene, path: Path) -> None:
        means, rotations, scales, opacities, harmonics = (tensor.detach().double().cpu() for tensor in scene.splats())
        degree = min(isqrt(harmonics.shape[1]) - 1, MAX_DEGREE)
        largest = float(means.abs().max())
        bits = min(MAX_FRACTION_BITS, floor(23 - log2(max(largest * (1 + 1e-6), 1e-9))))
        if bits < 0:
            raise UserError(f"coordinates up to {largest:g} exceed those of SPZ, 2^23; scale the scene down")
        fixed = np.round(means.numpy() * 2**bits).clip(-(2**23), 2**23 - 1).astype("<i4")
        columns = [
            fixed.reshape(-1, 1).view(np.uint8).reshape(-1, 4)[:, :3],
            _bytes(opacities.numpy() * 255),
            _bytes((harmonics[:, 0].numpy() * _COLOR_SCALE + 0.5) * 255),
            _bytes((scales.clamp_min(1e-12).log().numpy() + 10) * 16),
            _packed_rotations(F.normalize(rotations, dim=-1)[:, [1, 2, 3, 0]].numpy()),
            _bytes(harmonics[:, 1 : (degree + 1) ** 2].numpy() * 128 + 128),
        ]
        header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(means), degree, bits, 0, 0)
        with atomic_path(path) as temporary:
            temporary.write_bytes(gzip.compress(header + b"".join(column.tobytes() for column in columns), mtime=0))


def _bytes(values: NDArray[np.float64]) -> NDArray[np.uint8]:
    return np.round(values).clip(0, 255).astype(np.uint8)


def _packed_rotations(xyzw: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Smallest-three: 2 bits for the index of the largest component, a sign and 9 bits of magnitude for each other."""
    largest, others = smallest_three(xyzw)
    magnitude = np.round(np.abs(others) * sqrt(2) * 511).clip(0, 511).astype(np.uint32)
    fields = (others < 0).astype(np.uint32) << 9 | magnitude
    packed = largest.astype(np.uint32) << 30 | fields[:, 0] << 20 | fields[:, 1] << 10 | fields[:, 2]
    return packed.astype("<u4")
