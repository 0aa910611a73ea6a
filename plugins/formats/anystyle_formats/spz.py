"""SPZ, as described at github.com/nianticlabs/spz: version 3, the last without Zstandard, is written, 1 to 4 are read.

Its axes are right, up, back, unless an extension of Adobe's says otherwise. It has no field for notes.
"""

import gzip
import io
import logging
import struct
from math import floor, isqrt, log2, sqrt
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.errors import UserError, of_extra
from anystyle.io.atomic import final, write_bytes
from anystyle.io.ply import from_smallest_three
from anystyle.io.splats import Remarks
from anystyle.types import Gaussians, StyledScene
from anystyle_formats.packing import DEGREE, columns_of, in_bytes, joined_bits, smallest_three
from anystyle_formats.reading import gaussians, reading, room_for

MAGIC, VERSION = 0x5053474E, 3
_START = MAGIC.to_bytes(4, "little")
_log = logging.getLogger(__name__)
COARSER = 4
"""Bits that positions may lose for Gaussians far out, without a line."""
MAX_FRACTION_BITS = 18
"""Fractional bits of a fixed-point coordinate; large scenes get fewer."""
_COLOR_SCALE = 0.15
_AXES, _UP = 0xADBE0003, {4: "y", 6: "opencv", 12: "z"}
"""The type of the extension ``SPZ_ADOBE_coordinate_system``, and the numbers of the axes that exist here."""
_HALVES, _FIRST_THREE, _ZSTD = 1, 2, 4
"""Versions: the only one with half-precision positions, the last with rotations of three bytes, the first of Zstandard.
"""


class Spz(Format):
    """SPZ, as Niantic publishes it: compressed to about a tenth of a PLY file."""

    up = "y"
    has_antialiasing = reads = True
    max_degree = DEGREE

    def write(self, scene: StyledScene, path: Path) -> None:
        means, rotations, scales, opacities, harmonics = columns_of(scene.splats())
        degree = min(isqrt(harmonics.shape[1]) - 1, DEGREE)
        largest = float(np.abs(means).max())
        bits = _fraction_bits(largest)
        if bits < 0:
            raise UserError(f"coordinates up to {largest:g} exceed those of SPZ, 2^23; scale the scene down")
        _tell_coarse(path, np.abs(means).max(1), bits)
        _tell_cut(path, harmonics, scales)
        fixed = np.round(means * 2**bits).clip(-(2**23), 2**23 - 1).astype("<i4")
        columns = [
            fixed.reshape(-1, 1).view(np.uint8).reshape(-1, 4)[:, :3],
            in_bytes(opacities * 255),
            in_bytes((harmonics[:, 0] * _COLOR_SCALE + 0.5) * 255),
            in_bytes((np.log(np.maximum(scales, 1e-12)) + 10) * 16),
            _packed_rotations(rotations[:, [1, 2, 3, 0]]),
            in_bytes(harmonics[:, 1 : (degree + 1) ** 2] * 128 + 128),
        ]
        header = struct.pack("<IIIBBBB", MAGIC, VERSION, len(means), degree, bits, int(scene.antialiased), 0)
        write_bytes(path, gzip.compress(header + b"".join(column.tobytes() for column in columns), mtime=0))

    def read(self, path: Path) -> StyledScene:
        with reading(path, "SPZ file") as remarks:
            data = path.read_bytes()
            scene, up = decoded(data, remarks), _stated_up(data) or self.up
            flags = (data if data.startswith(_START) else gzip.GzipFile(fileobj=io.BytesIO(data)).read(16))[14]
        # Bit 0: trained with antialiasing. Bit 1: there are extensions.
        return StyledScene(((path.stem, scene.marked(bool(flags & 1))),), up=up)


def _fraction_bits(largest: float) -> int:
    """Of coordinates up to some size, so that they fit into three bytes."""
    return min(MAX_FRACTION_BITS, floor(23 - log2(max(largest * (1 + 1e-6), 1e-9))))


def _tell_coarse(path: Path, distances: NDArray[np.float64], bits: int) -> None:
    """Say in a line where a few Gaussians far out make the positions of all others coarse."""
    bulk = _fraction_bits(float(np.quantile(distances, 0.99, method="lower")))
    if bulk - bits > COARSER:
        far, step, fine = (distances >= 2.0 ** (23 - bulk)).sum(), 2.0**-bits, 2.0**-bulk
        line = "%s: positions are multiples of %g, and would be of %g without %s of %s Gaussians, which lie far out"
        _log.warning(line, final(path), step, fine, f"{far:,}", f"{len(distances):,}")


def _tell_cut(path: Path, harmonics: NDArray[np.float64], scales: NDArray[np.float64]) -> None:
    """Say in a line which values the bytes cannot hold."""
    constant, rest, sizes = np.abs(harmonics[:, 0]), harmonics[:, 1:], np.log(np.maximum(scales, 1e-12))
    cut = {
        "colours": (constant * _COLOR_SCALE > 0.5 + 0.5 / 255).any(1),
        "harmonics": ((rest * 128 < -128.5) | (rest * 128 > 127.5)).any((1, 2)),
        "sizes": ((sizes < -10 - 1 / 32) | (sizes > -10 + 255.5 / 16)).any(1),
    }
    told = ", ".join(f"{what} of {rows.sum():,}" for what, rows in cut.items() if rows.any())
    if told:
        _log.warning("%s: of %s Gaussians, what SPZ cannot hold is cut: %s", final(path), f"{len(scales):,}", told)


def _stated_up(data: bytes) -> str | None:
    """The axes that the record of an extension between the header of version 4 and the table names."""
    at, end = (32, struct.unpack_from("<I", data, 16)[0]) if data.startswith(_START) and data[14] & 2 else (0, 0)
    while at + 12 <= end:
        kind, size, value = struct.unpack_from("<III", data, at)
        if kind == _AXES:
            if value not in _UP:
                raise ValueError(f"its axes have the number {value}; right-handed ones with x to the right are read")
            return _UP[value]
        at += 8 + size
    return None


def decoded(data: bytes, remarks: Remarks) -> Gaussians:
    """The Gaussians of a file's content."""
    packed = data.startswith(_START)
    stream = gzip.GzipFile(fileobj=io.BytesIO(data))
    header = data if packed else stream.read(16)
    magic, version, count, degree, bits, _, streams = struct.unpack_from("<IIIBBBB", header)
    if magic != MAGIC or packed != (version >= _ZSTD) or not 1 <= version <= _ZSTD or degree > 4:
        raise ValueError(f"version {version} with degree {degree}; versions 1 to 4 and degrees 0 to 4 exist")
    count, higher = room_for(remarks.path, count), (degree + 1) ** 2 - 1
    widths = [6 if version == _HALVES else 9, 1, 3, 3, 3 if version <= _FIRST_THREE else 4, 3 * higher]
    size = count * sum(widths)
    content = _zstd(data, streams, size) if packed else stream.read(size)
    whole = np.frombuffer(content, np.uint8)
    if len(whole) != size:
        raise ValueError(f"{len(whole):,} bytes of {count:,} Gaussians, which take {size:,}")
    ends = np.cumsum([count * width for width in widths])[:-1]
    position, alpha, color, scale, turn, rest = (
        part.reshape(count, width) for part, width in zip(np.split(whole, ends), widths, strict=True)
    )
    harmonics = (rest.reshape(count, higher, 3) - 128.0) / 128
    constant = (color[:, None] / 255 - 0.5) / _COLOR_SCALE
    return gaussians(
        remarks,
        position.view("<f2") if version == _HALVES else _fixed(position) / 2**bits,
        (_first_three(turn) if version <= _FIRST_THREE else _smallest_three(turn.view("<u4")[:, 0]))[:, [3, 0, 1, 2]],
        np.exp(scale / 16 - 10),
        alpha[:, 0] / 255,
        np.concatenate([constant, harmonics], 1),
    )


def _zstd(data: bytes, streams: int, expected: int) -> bytes:
    """The streams of version 4, one per attribute, behind a table of their sizes."""
    zstandard = of_extra("zstandard", "SPZ files of version 4 need", "spz")
    (start,) = struct.unpack_from("<I", data, 16)
    sizes = struct.unpack_from(f"<{2 * streams}Q", data, start)
    if sum(sizes[1::2]) != expected:
        raise ValueError(f"{sum(sizes[1::2]):,} bytes of Gaussians that take {expected:,}")
    at, parts = start + 16 * streams, []
    for packed, size in zip(sizes[::2], sizes[1::2], strict=True):
        parts.append(zstandard.ZstdDecompressor().stream_reader(data[at : at + packed]).read(size))
        at += packed
    return b"".join(parts)


def _fixed(position: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Signed integers of three bytes."""
    low, middle, high = np.moveaxis(position.reshape(-1, 3, 3).astype(np.int64), -1, 0)
    return low | middle << 8 | (high ^ 128) - 128 << 16


def _first_three(xyz: NDArray[np.uint8]) -> NDArray[np.float64]:
    imaginary = xyz / 127.5 - 1
    return np.concatenate([imaginary, np.sqrt((1 - np.square(imaginary).sum(1, keepdims=True)).clip(0))], 1)


def _smallest_three(packed: NDArray[np.uint32]) -> NDArray[np.float64]:
    fields = np.stack([packed >> shift & 1023 for shift in (20, 10, 0)], 1)
    others = (fields & 511) / 511 / sqrt(2) * np.where(fields >> 9, -1, 1)
    return from_smallest_three((packed >> 30).astype(np.int64), others)


def _packed_rotations(xyzw: NDArray[np.float64]) -> NDArray[np.uint32]:
    """Smallest-three: 2 bits for the index of the largest component, a sign and 9 bits of magnitude for each other."""
    largest, others = smallest_three(xyzw)
    magnitude = np.round(np.abs(others) * sqrt(2) * 511).clip(0, 511).astype(np.uint32)
    return joined_bits(largest, (others < 0).astype(np.uint32) << 9 | magnitude)
