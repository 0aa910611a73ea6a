"""Scenes as arrays, numbers in few bits, and an order in which they compress well."""

import logging
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float, UInt8
from numpy.typing import NDArray

from anystyle.geometry.harmonics import CONSTANT
from anystyle.io.atomic import final
from anystyle.io.splats import Splats

_log = logging.getLogger(__name__)
DEGREE = 3
"""The highest of harmonics in SPZ and SOG, as their other readers have it."""


class Columns(NamedTuple):
    """The arrays of one scene, as :class:`anystyle.types.Gaussians` has its tensors, with unit quaternions."""

    means: Float[np.ndarray, "N 3"]
    rotations: Float[np.ndarray, "N 4"]
    scales: Float[np.ndarray, "N 3"]
    opacities: Float[np.ndarray, " N"]
    harmonics: Float[np.ndarray, "N K 3"]


def columns_of(splats: Splats) -> Columns:
    """The arrays of one scene in float64."""
    means, rotations, *rest = (tensor.detach().to("cpu", torch.float64) for tensor in splats)
    return Columns(*(tensor.numpy() for tensor in (means, F.normalize(rotations, dim=-1), *rest)))


def in_bytes(values: Float[np.ndarray, "*shape"]) -> NDArray[np.uint8]:
    """The nearest integers from 0 to 255."""
    return np.round(values).clip(0, 255).astype(np.uint8)


def color_bytes(path: Path, columns: Columns) -> UInt8[np.ndarray, "N 4"]:
    """Constant colours and opacities; a line says of how many Gaussians bytes cannot hold the colours."""
    colors = columns.harmonics[:, 0] * CONSTANT + 0.5
    if cut := int((np.abs(colors - 0.5) > 0.5 + 0.5 / 255).any(1).sum()):
        _log.warning("%s: colours of %s of %s Gaussians are cut to [0, 1]", final(path), f"{cut:,}", f"{len(colors):,}")
    return in_bytes(np.concatenate([colors, columns.opacities[:, None]], 1) * 255)


def in_words(
    means: Float[np.ndarray, "N 3"],
) -> tuple[NDArray[np.uint16], Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Positions on a logarithmic scale as 16-bit integers, and what 0 and 65535 stand for."""
    far = np.sign(means) * np.log1p(np.abs(means))
    low, high = far.min(0), far.max(0)
    return np.round((far - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2"), low, high


def smallest_three(quaternions: Float[np.ndarray, "N 4"]) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """The index of the largest component of each unit quaternion, and the other three in order, in ±1/√2.

    The quaternion's sign is the one that makes the largest component positive.
    """
    largest = np.abs(quaternions).argmax(1)
    signs = np.where(np.take_along_axis(quaternions, largest[:, None], 1) < 0, -1.0, 1.0)
    return largest, (quaternions * signs)[np.arange(4) != largest[:, None]].reshape(-1, 3)


def joined_bits(largest: NDArray[np.int64], others: NDArray[np.integer]) -> NDArray[np.uint32]:
    """An index of 2 bits and three numbers of 10 in 32 bits, from the highest bit on."""
    return (largest.astype(np.uint32) << 30 | others[:, 0] << 20 | others[:, 1] << 10 | others[:, 2]).astype("<u4")


def morton_order(points: Float[np.ndarray, "N 3"]) -> NDArray[np.int64]:
    """An order in which neighbours in space are neighbours in the file, which packs better."""
    low, high = points.min(0, initial=0.0), points.max(0, initial=0.0)
    cells = ((points - low) / np.maximum(high - low, 1e-12) * 1023).astype(np.uint64)
    code = np.zeros(len(points), np.uint64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> np.uint64(bit) & np.uint64(1)) << np.uint64(3 * bit + axis)
    return np.argsort(code, kind="stable")


def codebook(values: NDArray[np.float64], rounds: int = 32) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Scalar quantisation: 256 ascending levels by Lloyd's algorithm, and the index of the level of each value.

    Half of the levels start at quantiles, which cover the bulk, half evenly spaced, which covers outliers. In each
    round the levels that no value is nearest to divide the cells of the largest squared errors.
    """
    flat = np.sort(values.ravel())
    quantiles = np.quantile(flat, (np.arange(128) + 0.5) / 128)
    levels = np.sort(np.concatenate([quantiles, np.linspace(flat[0], flat[-1], 128)]))
    sums, squares = (np.concatenate([[0.0], np.cumsum(each)]) for each in (flat, flat**2))
    for remaining in reversed(range(rounds)):
        bounds = np.concatenate([[0], np.searchsorted(flat, (levels[1:] + levels[:-1]) / 2), [len(flat)]])
        counts = np.diff(bounds)
        means = np.diff(sums[bounds]) / np.maximum(counts, 1)
        levels, empty = np.where(counts > 0, means, levels), np.flatnonzero(counts == 0)
        if remaining and len(empty):
            errors = np.where(counts > 1, np.diff(squares[bounds]) - counts * means**2, 0.0)
            worst = errors.argsort()[::-1][: min(len(empty), int((errors > 0).sum()))]
            spread = np.sqrt(errors[worst] / counts[worst])
            levels[empty[: len(worst)]], levels[worst] = means[worst] + spread, means[worst] - spread
        levels = np.sort(levels)
    return levels, np.searchsorted((levels[1:] + levels[:-1]) / 2, values).astype(np.uint8)
