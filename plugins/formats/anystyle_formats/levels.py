"""Levels of detail of a scene: Gaussians merged in pairs, with weights that colours have no part in.

Coarser levels merge Gaussians as Kerbl et al. do ("A Hierarchical 3D Gaussian Representation", 2024, section 4).
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, log, log2
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anystyle_formats.packing import Columns, cuts, kd_order, morton_order

CHUNK = 65_536
"""Gaussians in a chunk at most: with all attributes but view-dependent colour, less than a megabyte."""
COARSEST = 49_152
"""Gaussians of the coarsest level; each finer one has about four times as many, all by one factor."""
NEIGHBOURS = 4
"""The nearest Gaussians that one may be merged with."""


@dataclass(frozen=True)
class Level:
    """A level of detail: its Gaussians, and the leaf that each is in, from 0 on in ascending order."""

    columns: Columns
    leaf: NDArray[np.int64]

    @cached_property
    def runs(self) -> list[int]:
        """Where the Gaussians of each leaf begin, and the end."""
        return np.searchsorted(self.leaf, np.arange(self.leaf[-1] + 2)).tolist()

    @cached_property
    def step(self) -> int:
        """The number of leaves in a chunk: a power of two, as that of all is."""
        leaves = len(self.runs) - 1
        return min(leaves, max(1, 2 ** int(log2(CHUNK * leaves / len(self.leaf)))))

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 L 3"]:
        """What the Gaussians of each leaf reach with one standard deviation: lowest and highest coordinates."""
        reach, starts = np.sqrt(np.einsum("nii->ni", covariances(self.columns))), self.runs[:-1]
        low = np.minimum.reduceat(self.columns.means - reach, starts)
        return np.stack([low, np.maximum.reduceat(self.columns.means + reach, starts)])


def levels_of(columns: Columns) -> list[Level]:
    """A scene in levels of detail, the finest first, in the leaves of a k-d tree and there in Morton order."""
    count = len(columns.means)
    depth = max(0, ceil(log2(count / CHUNK)))
    leaf = np.repeat(np.arange(2**depth), np.diff(cuts(count, 2**depth)))
    order, rank = kd_order(columns.means, depth), np.argsort(morton_order(columns.means))
    order = order[np.lexsort((rank[order], leaf))]
    levels = [Level(Columns(*(column[order] for column in columns)), leaf)]
    steps = max(1, round(log(count / COARSEST, 4))) if 5 * count >= 6 * COARSEST else 0
    for step in range(1, steps + 1):
        levels.append(coarser(levels[-1], round(count * (COARSEST / count) ** (step / steps))))
    return levels


class Moments(NamedTuple):
    """What merging keeps: masses, which are opacities times areas, and means that these are the weights of."""

    masses: Float[np.ndarray, " N"]
    means: Float[np.ndarray, "N 3"]
    covariances: Float[np.ndarray, "N 3 3"]
    harmonics: Float[np.ndarray, "N K 3"]

    def rows(self, index: NDArray[np.integer]) -> "Moments":
        """Some of them."""
        return Moments(*(each[index] for each in self))


def area(covariance: Float[np.ndarray, "*N 3 3"]) -> Float[np.ndarray, "*N"]:
    """Surfaces of ellipsoids, up to a factor: the root of the sum of squared products of two half axes."""
    trace = np.einsum("...ii", covariance)
    return np.sqrt(np.maximum(trace**2 - np.square(covariance).sum((-2, -1)), 0) / 2)


def covariances(columns: Columns) -> Float[np.ndarray, "N 3 3"]:
    """Covariances of Gaussians."""
    axes = Rotation.from_quat(columns.rotations[:, [1, 2, 3, 0]]).as_matrix() * columns.scales[:, None]
    return axes @ axes.swapaxes(1, 2)


def moments_of(columns: Columns) -> Moments:
    """The moments of Gaussians."""
    spread = covariances(columns)
    return Moments(np.maximum(columns.opacities * area(spread), 1e-30), columns.means, spread, columns.harmonics)


def columns_with(moments: Moments) -> Columns:
    """Gaussians with given moments."""
    variances, axes = np.linalg.eigh(moments.covariances)
    axes[..., 0] *= np.linalg.det(axes)[:, None]  # eigenvectors may be mirrored
    rotations = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    opacities = (moments.masses / np.maximum(area(moments.covariances), 1e-30)).clip(0, 1)
    return Columns(moments.means, rotations, np.sqrt(variances.clip(0)), opacities, moments.harmonics)


def merged(first: Moments, second: Moments) -> Moments:
    """The moments of pairs, unless an opacity would exceed 1."""
    share = first.masses / (first.masses + second.masses)

    def mean(ones: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
        weights = share.reshape(-1, *(1,) * (ones.ndim - 1))
        return weights * ones + (1 - weights) * others

    spread = _spread(first, second)
    masses = np.minimum(first.masses + second.masses, np.maximum(area(spread), 1e-30))  # of opacity 1 at most
    return Moments(masses, mean(first.means, second.means), spread, mean(first.harmonics, second.harmonics))


def _spread(first: Moments, second: Moments) -> Float[np.ndarray, "N 3 3"]:
    """The covariances of pairs."""
    share = (first.masses / (first.masses + second.masses))[:, None, None]
    away = (first.means - second.means)[:, None]
    return share * first.covariances + (1 - share) * (second.covariances + share * away * away.swapaxes(1, 2))


def coarser(level: Level, size: int) -> Level:
    """Merge neighbours of the same leaf in pairs, the smallest pairs first, until ``size`` Gaussians are left."""
    moments, leaf = moments_of(level.columns), level.leaf
    while len(leaf) > size and len(pairs := _pairs(moments, leaf)):
        first, second = pairs[: len(leaf) - size].T
        pair, left = merged(moments.rows(first), moments.rows(second)), np.delete(np.arange(len(leaf)), second)
        moments, leaf = moments.rows(left), leaf[left]
        for values, of_pairs in zip(moments, pair, strict=True):
            values[np.searchsorted(left, first)] = of_pairs
    return Level(columns_with(moments), leaf)


def _pairs(moments: Moments, leaf: NDArray[np.int64]) -> NDArray[np.int64]:
    """Pairs in which each is the other's best partner, the smallest first; no Gaussian is in two."""
    count = len(leaf)
    near = KDTree(moments.means, balanced_tree=False).query(moments.means, 1 + NEIGHBOURS)[1]
    one, other = np.repeat(np.arange(count), 1 + NEIGHBOURS), near.ravel()
    within = (one != other) & (other < count)
    within[within] = leaf[one[within]] == leaf[other[within]]
    one, other = one[within], other[within]
    shape = moments._replace(harmonics=moments.harmonics[:, :0])
    order = np.argsort(area(_spread(shape.rows(one), shape.rows(other))))
    pairs, rank = np.stack([one, other], 1)[order], np.arange(len(order))
    best = np.full(count, -1)
    best[pairs[::-1].ravel()] = np.repeat(rank[::-1], 2)  # of several pairs the last that is written, the smallest
    return pairs[(best[pairs] == rank[:, None]).all(1)]
