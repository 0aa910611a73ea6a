"""Streamed SOG: a folder with the scene in levels of detail and all styles, and a page that loads it in parts.

The format is described in PlayCanvas's user manual (developer.playcanvas.com, "The Streamed SOG Format", version 1).
The leaves of a k-d tree hold runs of Gaussians in chunks of each level, and every chunk is an unbundled SOG scene.
Coarser levels merge Gaussians as Kerbl et al. do ("A Hierarchical 3D Gaussian Representation", 2024, section 4), with
weights that colours have no part in: all styles share their images of positions, sizes and rotations.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from math import ceil, log2
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_directory
from anystyle.pipeline.styles import slug
from anystyle.types import StyledScene
from anystyle_formats.html import page_of
from anystyle_formats.packing import Columns, columns_of, cuts, kd_order, morton_order
from anystyle_formats.sog import asset, encoded_colors, encoded_shape

CHUNK = 65_536
"""Gaussians in a chunk at most: with all attributes but view-dependent colour, less than a megabyte."""
COARSEST = 49_152
"""Gaussians of the coarsest level; each finer one that is merged has four times as many."""
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


class Lod(Format):
    """Streamed SOG in all styles: ``lod-meta.json`` is the last, ``styles`` has the others, ``index.html`` the page."""

    index = "lod-meta.json"
    has_notes = many_styles = True
    shared = ("means", "rotations", "scales", "opacities")

    def write(self, scene: StyledScene, path: Path) -> None:
        styles = [columns_of(scene.splats(index)) for index in range(len(scene.styles))]
        harmonics = [style.harmonics for style in styles]
        # Those of all styles are merged as if they were one.
        levels = levels_of(styles[-1]._replace(harmonics=np.concatenate(harmonics, 1)))
        ends = np.cumsum([each.shape[1] for each in harmonics])[:-1]
        titles = [title for title, _ in scene.styles[:-1]]
        folders = [f"styles/{number}-{slug(title)}/" for number, title in enumerate(titles, 1)] + [""]
        index = json.dumps(index_of(levels) | {"asset": asset(scene.notes)})
        page = page_of(scene, {"rotations": [0]}, [{"rotation": 0, "folder": folder} for folder in folders])
        with atomic_directory(path, overwrite=True) as target:
            for number, level in enumerate(levels):
                for chunk, (start, end) in enumerate(pairwise(level.runs[:: level.step])):
                    part = Columns(*(column[start:end] for column in level.columns))
                    colors = zip(folders, np.split(part.harmonics, ends, 1), strict=True)
                    _write_chunk(target, f"{number}_{chunk}", part, dict(colors))
            for folder in folders:
                (target / folder / self.index).write_text(index, encoding="utf-8")
            (target / "index.html").write_text(page, encoding="utf-8", errors="backslashreplace")


def levels_of(columns: Columns) -> list[Level]:
    """A scene in levels of detail, the finest first, in the leaves of a k-d tree and there in Morton order."""
    count = len(columns.means)
    depth = max(0, ceil(log2(count / CHUNK)))
    leaf = np.repeat(np.arange(2**depth), np.diff(cuts(count, 2**depth)))
    order, rank = kd_order(columns.means, depth), np.argsort(morton_order(columns.means))
    order = order[np.lexsort((rank[order], leaf))]
    levels = [Level(Columns(*(column[order] for column in columns)), leaf)]
    for size in (COARSEST * 4**step for step in range(15, -1, -1)):
        if 6 * size <= 5 * count:
            levels.append(coarser(levels[-1], size))
    return levels


def index_of(levels: Sequence[Level]) -> dict[str, Any]:
    """``lod-meta.json`` but for what it says of the scene."""
    low, high = np.stack([level.bounds for level in levels]).swapaxes(0, 1)  # levels L 3 each
    files = [(number, leaf) for number, level in enumerate(levels) for leaf in range(0, low.shape[1], level.step)]
    nodes: list[dict[str, Any]] = []
    for leaf in range(low.shape[1]):
        lods = {}
        for number, level in enumerate(levels):
            first, (start, end) = leaf - leaf % level.step, level.runs[leaf : leaf + 2]
            place = {"file": files.index((number, first)), "offset": start - level.runs[first], "count": end - start}
            lods[str(number)] = place
        bound = {"min": low[:, leaf].min(0).tolist(), "max": high[:, leaf].max(0).tolist()}
        nodes.append({"bound": bound, "lods": lods})
    while len(nodes) > 1:
        nodes = [_parent(*pair) for pair in zip(nodes[::2], nodes[1::2], strict=True)]
    counts = [len(level.leaf) for level in levels]
    return {
        "version": 1,
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(levels),
        "filenames": [f"{number}_{leaf // levels[number].step}/meta.json" for number, leaf in files],
        "tree": nodes[0],
    }


def _parent(*nodes: dict[str, Any]) -> dict[str, Any]:
    low, high = (np.stack([node["bound"][end] for node in nodes]) for end in ("min", "max"))
    return {"bound": {"min": low.min(0).tolist(), "max": high.max(0).tolist()}, "children": list(nodes)}


def _write_chunk(folder: Path, name: str, part: Columns, colors: Mapping[str, NDArray[np.float64]]) -> None:
    """A chunk in all styles, by their folders; the images of its geometry are in that of the last."""
    shape, shared = encoded_shape(part)
    about = {"version": 2, "asset": {"generator": "anystyle"}, "count": len(part.means), "antialias": False}
    for inside, harmonics in colors.items():
        here = "../" * (inside.count("/") + 1) + f"{name}/" if inside else ""
        named = {key: {**value, "files": [here + file for file in value["files"]]} for key, value in shape.items()}
        meta, images = encoded_colors(part._replace(harmonics=harmonics))
        target = folder / inside / name
        target.mkdir(parents=True)
        (target / "meta.json").write_text(json.dumps({**about, **named, **meta}), encoding="utf-8")
        for file, data in {**images, **({} if inside else shared)}.items():
            (target / file).write_bytes(data)


def covariances(columns: Columns) -> Float[np.ndarray, "N 3 3"]:
    """Covariances of Gaussians."""
    axes = Rotation.from_quat(columns.rotations[:, [1, 2, 3, 0]]).as_matrix() * columns.scales[:, None]
    return axes @ axes.swapaxes(1, 2)


def area(covariance: Float[np.ndarray, "*N 3 3"]) -> Float[np.ndarray, "*N"]:
    """Surfaces of ellipsoids, up to a factor: the root of the sum of squared products of two half axes."""
    trace = np.einsum("...ii", covariance)
    return np.sqrt(np.maximum(trace**2 - np.square(covariance).sum((-2, -1)), 0) / 2)


def merged(columns: Columns, starts: NDArray[np.int64]) -> Columns:
    """One Gaussian for each run of them, with their mean, covariance and mean colour, weighted by opacity times area.

    Its opacity times area is the sum of theirs, unless its opacity would exceed 1.

    Args:
        columns: The Gaussians.
        starts: Where runs begin; the first is 0.
    """
    spread = covariances(columns)
    weights = np.maximum(columns.opacities * area(spread), 1e-30)
    totals = np.add.reduceat(weights, starts)

    def mean(values: NDArray[np.float64]) -> NDArray[np.float64]:
        shape = (-1, *(1,) * (values.ndim - 1))
        return np.add.reduceat(weights.reshape(shape) * values, starts) / totals.reshape(shape)

    centers = mean(columns.means)
    away = columns.means - np.repeat(centers, np.diff(starts, append=len(weights)), 0)
    spread = mean(spread + away[:, :, None] * away[:, None])
    variances, axes = np.linalg.eigh(spread)
    axes[..., 0] *= np.linalg.det(axes)[:, None]  # eigenvectors may be mirrored
    rotations = Rotation.from_matrix(axes).as_quat()[:, [3, 0, 1, 2]]
    opacities = (totals / np.maximum(area(spread), 1e-30)).clip(0, 1)
    return Columns(centers, rotations, np.sqrt(variances.clip(0)), opacities, mean(columns.harmonics))


def coarser(level: Level, size: int) -> Level:
    """Merge neighbours of the same leaf in pairs, the smallest pairs first, until ``size`` Gaussians are left."""
    while len(level.leaf) > size and len(pairs := _pairs(level)):
        lead = np.arange(len(level.leaf))
        first, second = pairs[: len(level.leaf) - size].T
        lead[second] = first
        order = np.argsort(lead, kind="stable")
        starts = np.flatnonzero(np.diff(lead[order], prepend=-1))
        ordered = Columns(*(column[order] for column in level.columns))
        level = Level(merged(ordered, starts), level.leaf[order[starts]])
    return level


def _pairs(level: Level) -> NDArray[np.int64]:
    """Pairs in which each is the other's best partner, the smallest first; no Gaussian is in two."""
    columns, leaf, count = level.columns, level.leaf, len(level.leaf)
    near = KDTree(columns.means).query(columns.means, 1 + NEIGHBOURS)[1]
    ends = np.sort(np.stack([np.repeat(np.arange(count), 1 + NEIGHBOURS), near.ravel()], 1), 1)
    first, second = np.divmod(np.unique(ends[ends[:, 1] < count] @ [count, 1]), count)  # each pair once
    apart = (first < second) & (leaf[first] == leaf[second])
    first, second = first[apart], second[apart]
    spread = covariances(columns)
    weights = np.maximum(columns.opacities * area(spread), 1e-30)
    share = (weights[first] / (weights[first] + weights[second]))[:, None, None]
    away = (columns.means[first] - columns.means[second])[:, None]
    both = share * spread[first] + (1 - share) * (spread[second] + share * away * away.swapaxes(1, 2))
    order = np.argsort(area(both))
    pairs, rank = np.stack([first, second], 1)[order], np.arange(len(order))
    best = np.full(count, -1)
    best[pairs[::-1].ravel()] = np.repeat(rank[::-1], 2)  # of several pairs the last that is written, the smallest
    return pairs[(best[pairs] == rank[:, None]).all(1)]
