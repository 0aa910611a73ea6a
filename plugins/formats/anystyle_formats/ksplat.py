"""KSPLAT, version 0.1, of the viewer GaussianSplats3D (github.com/mkkellogg/GaussianSplats3D): level 0 is written.

A header and one of each section come first; then the sections, each with the centres of its buckets and rows of
Gaussians. Above level 0 positions are 16-bit integers about the centre of a bucket. Colours are bytes.
"""

import struct
from collections.abc import Iterator
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.geometry.harmonics import CONSTANT
from anystyle.io.atomic import write_bytes
from anystyle.io.splats import Remarks
from anystyle.types import StyledScene
from anystyle_formats.packing import color_bytes, columns_of
from anystyle_formats.reading import gaussians, reading, room_for

HEADER, SECTION = 4096, 1024
_START, _SECTION = struct.Struct("<BBxxIIIIHxx3fff"), struct.Struct("<IIIIfHxxIIIIH")
_DEGREE = 2
"""The highest that the viewer shows."""
_RANGE = 1.5
"""Of harmonics in bytes, where the header has none."""
_TOP = 32767
"""What stands for half the side of a bucket, where the section has none."""
_KINDS = ("<f4", "<f4", "<f4"), ("<u2", "<f2", "<f2"), ("<u2", "<f2", "u1")
"""Of positions, of scales and rotations, and of harmonics, by level."""


class Ksplat(Format):
    """KSPLAT, as GaussianSplats3D reads it: float32, colours in bytes, harmonics up to degree 2."""

    reads = True
    max_degree = _DEGREE

    def write(self, scene: StyledScene, path: Path) -> None:
        means, rotations, scales, _, harmonics = columns = columns_of(scene.splats())
        degree = min(isqrt(harmonics.shape[1]) - 1, _DEGREE)
        rows = np.zeros(len(means), _row(0, degree))
        rows["mean"], rows["scale"], rows["turn"] = means, scales, rotations
        rows["color"] = color_bytes(path, columns)
        bands = (harmonics[:, band].mT.reshape(len(rows), -1) for band in _bands(degree))
        rows["rest"] = np.concatenate([harmonics[:, :0, 0], *bands], 1)
        start = _START.pack(0, 1, 1, 1, len(rows), len(rows), 0, *means.mean(0), -_RANGE, _RANGE)
        section = _SECTION.pack(len(rows), len(rows), 0, 0, 0.0, 0, 0, rows.nbytes, 0, 0, degree)
        write_bytes(path, start.ljust(HEADER, b"\0") + section.ljust(SECTION, b"\0") + rows.tobytes())

    def read(self, path: Path) -> StyledScene:
        with reading(path, "KSPLAT file") as remarks:
            data = path.read_bytes()
            major, minor, number, used, _, count, level, *_, low, high = _START.unpack_from(data)
            if major != 0 or minor < 1 or level >= len(_KINDS):
                raise ValueError(f"version {major}.{minor}, level {level}; version 0.1 and levels 0 to 2 exist")
            room_for(path, count)
            parts = list(_sections(data, number, level, remarks))
            rows = [part.rows for part in parts]
            color = np.concatenate([part["color"] for part in rows]) / 255
            most = max(part.degree for part in parts)
            harmonics = np.zeros((len(color), (most + 1) ** 2, 3))
            harmonics[:, 0] = (color[:, :3] - 0.5) / CONSTANT
            at = 0
            for part in parts:
                rest = part.rows["rest"].astype(np.float64)
                if level == 2:
                    low, high = low or -_RANGE, high or _RANGE
                    rest = low + rest / 255 * (high - low)
                # gaussforge, which alone says that no section is in use, has all of red first, then green, then blue.
                for band in _bands(part.degree) if used else [slice(1, (part.degree + 1) ** 2)]:
                    values = rest[:, 3 * band.start - 3 : 3 * band.stop - 3].reshape(-1, 3, band.stop - band.start)
                    harmonics[at : at + len(rest), band] = values.mT
                at += len(rest)
            turns, scales = (np.concatenate([part[name] for part in rows]) for name in ("turn", "scale"))
            means = np.concatenate([part.means for part in parts])
            scene = gaussians(remarks, means, turns, scales, color[:, 3], harmonics)
        return StyledScene(((path.stem, scene),))


class _Part(NamedTuple):
    rows: NDArray[Any]
    means: NDArray[np.float64]
    degree: int


def _sections(data: bytes, number: int, level: int, remarks: Remarks) -> Iterator[_Part]:
    start = HEADER + number * SECTION
    for index in range(number):
        count, room, size, buckets, block, width, top, _, full, partial, degree = _SECTION.unpack_from(
            data, HEADER + index * SECTION
        )
        lengths = np.frombuffer(data, "<u4", partial, start)
        centers = np.frombuffer(data, "<f4", 3 * buckets, start + 4 * partial).reshape(-1, 3)
        row, first = _row(level, degree), start + 4 * partial + width * buckets
        if (there := (len(data) - first) // row.itemsize) < count:
            remarks.guesses.append(f"the file ends after {max(there, 0):,} of {count:,} Gaussians of a section")
            count = max(there, 0)
        rows = np.frombuffer(data, row, count, min(first, len(data)))
        means = rows["mean"].astype(np.float64)
        if level:
            if full + partial != buckets:
                raise ValueError(f"{full:,} full and {partial:,} other buckets of {buckets:,}")
            ends = np.cumsum([*[size] * full, *lengths])
            bucket = np.searchsorted(ends, np.arange(count), side="right")
            means = (means - (top or _TOP)) * (block / 2 / (top or _TOP)) + centers[bucket]
        yield _Part(rows, means, degree)
        start = first + row.itemsize * room


def _row(level: int, degree: int) -> np.dtype:
    position, number, rest = _KINDS[level]
    higher = 3 * ((degree + 1) ** 2 - 1)
    return np.dtype(
        [("mean", position, 3), ("scale", number, 3), ("turn", number, 4), ("color", "u1", 4), ("rest", rest, higher)]
    )


def _bands(degree: int) -> list[slice]:
    """The coefficients of each degree above 0; a file has those of red, then of green, then of blue."""
    return [slice(band**2, (band + 1) ** 2) for band in range(1, degree + 1)]
