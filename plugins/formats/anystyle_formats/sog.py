"""SOG, version 2: quantised attributes as lossless WebP images and ``meta.json`` in one archive; version 1 is read.

The format is described in PlayCanvas's user manual (developer.playcanvas.com, "The SOG format"). Its axes are those of
3DGS PLY files: programs that read both rotate both alike.
"""

import io
import json
import re
import zipfile
from collections.abc import Mapping
from math import ceil, isqrt, sqrt
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parse_json
from anystyle.io.images import opened, require_pixels
from anystyle.io.limits import require
from anystyle.io.ply import from_smallest_three
from anystyle.io.splats import near
from anystyle.types import StyledScene
from anystyle_formats.packing import (
    DEGREE,
    Columns,
    codebook,
    columns_of,
    in_bytes,
    in_words,
    morton_order,
    smallest_three,
)
from anystyle_formats.reading import gaussians, reading, room_for

PALETTE = 65_536
"""The format's limit on distinct sets of higher harmonics."""
RIGHTS = re.compile(r"licen[cs]e|copyright|©|\b(?:Apache|MIT|BSD|GPL|CC)[- ]", re.IGNORECASE)
"""Notes that say who may do what: glTF's field ``copyright``, which SOG has, is for these alone."""
Encoded = tuple[dict[str, Any], dict[str, bytes]]
"""Attributes in ``meta.json``, and their images by name."""


class Sog(Format):
    """SOG, as PlayCanvas reads it: attributes as images in one ZIP file."""

    has_antialiasing = has_notes = reads = True
    max_degree = DEGREE

    def write(self, scene: StyledScene, path: Path) -> None:
        columns = columns_of(scene.splats())
        order = morton_order(columns.means)
        columns = Columns(*(column[order] for column in columns))
        (shape, images), (colors, more) = _encoded_shape(columns), _encoded_colors(columns)
        rights = [note for note in scene.notes if RIGHTS.search(note)]
        others = [note for note in scene.notes if note not in rights]
        asset = {"generator": "anystyle", "copyright": "\n".join(rights), "extras": {"notes": others}}
        meta = {"version": 2, "asset": asset, "count": len(order), "antialias": scene.antialiased, **shape, **colors}
        if scene.antialiased:  # as splat-transform has it, which does not read the other
            meta["model"] = "antialiased"
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
            for name, data in {"meta.json": json.dumps(meta).encode(), **images, **more}.items():
                archive.writestr(zipfile.ZipInfo(name), data)

    def read(self, path: Path) -> StyledScene:
        with reading(path, "SOG file") as remarks, zipfile.ZipFile(path) as archive:
            file = next((name for name in archive.namelist() if PurePosixPath(name).name == "meta.json"), "meta.json")
            meta = parse_json(_member(archive, file), dict[str, Any], source=str(path), what="SOG file")
            means, *columns = _decoded(archive, PurePosixPath(file).parent, meta, path)
            positions, offset = near(means, remarks)
            mode = bool(meta.get("antialias")) or meta.get("model") == "antialiased"
            scene = gaussians(remarks, positions, *columns).marked(mode)
            asset = meta.get("asset", {})
            others = map(str, asset.get("extras", {}).get("notes", []))
            notes = [*str(asset.get("copyright", "")).splitlines(), *others]
        return StyledScene(((path.stem, scene),), notes=tuple(notes), offset=offset)


def _decoded(archive: zipfile.ZipFile, folder: PurePosixPath, meta: Mapping[str, Any], source: Path) -> Columns:
    """The Gaussians that ``meta.json``, of either version, describes; its images are in the same folder."""
    # Version 1 has the count in the shape of the means, and no codebooks.
    count = room_for(source, meta["count"] if "count" in meta else meta["means"]["shape"][0])

    def pixels_of(part: str, file: int = 0, rows: int | None = count) -> NDArray[np.int64]:
        """Pixels in RGBA, in a grid where the number of rows is not given: rows 4."""
        name = meta[part]["files"][file]
        with opened(_member(archive, str(folder / name)), f"{source}: {name}") as image:
            require_pixels(image, 1 << 16)
            pixels = np.asarray(image.convert("RGBA")).astype(np.int64)
        if rows is None:
            return pixels
        pixels = pixels.reshape(-1, 4)
        if len(pixels) < rows:
            raise ValueError(f"{name} has {len(pixels):,} pixels for {rows:,} Gaussians")
        return pixels[:rows]

    low, high = (pixels_of("means", file)[:, :3] for file in (0, 1))
    far = _between(meta["means"], (low | high << 8) / 65535)
    turns, color = pixels_of("quats"), pixels_of("sh0")
    wxyz = from_smallest_three(turns[:, 3] - 252, (turns[:, :3] / 255 - 0.5) * sqrt(2))
    alpha = color[:, 3] / 255
    if not meta["sh0"].get("codebook"):
        alpha = 1 / (1 + np.exp(-_between(meta["sh0"], color / 255)[:, 3]))
    harmonics = _leveled(meta["sh0"], color)[:, None, :3]
    if meta.get("shN") is not None:
        label, book = pixels_of("shN", 1), pixels_of("shN", rows=None)
        # A row of pixels has 64 centroids, their coefficients side by side.
        centroids = _leveled(meta["shN"], book[..., :3]).reshape(-1, book.shape[1] // 64, 3)
        harmonics = np.concatenate([harmonics, centroids[label[:, 0] | label[:, 1] << 8]], 1)
    scales = np.exp(_leveled(meta["scales"], pixels_of("scales")[:, :3]))
    return Columns(np.sign(far) * np.expm1(np.abs(far)), wxyz, scales, alpha, harmonics)


def _encoded_shape(columns: Columns) -> Encoded:
    """Positions, sizes and rotations of Gaussians in their order."""
    means, rotations, scales, *_ = columns
    positions, low, high = in_words(means)
    largest, others = smallest_three(rotations)
    book, index = codebook(np.log(np.maximum(scales, 1e-12)))
    meta = {
        "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
        "scales": {"codebook": book.tolist(), "files": ["scales.webp"]},
        "quats": {"files": ["quats.webp"]},
    }
    pictures = {
        "means_l.webp": positions & 255,
        "means_u.webp": positions >> 8,
        "quats.webp": np.concatenate([np.round((others / sqrt(2) + 0.5) * 255), 252 + largest[:, None]], 1),
        "scales.webp": index,
    }
    return meta, {name: _webp(values, _width(len(means))) for name, values in pictures.items()}


def _encoded_colors(columns: Columns) -> Encoded:
    """Colours and opacities of Gaussians in their order."""
    harmonics, width = columns.harmonics, _width(len(columns.means))
    book, index = codebook(harmonics[:, 0])
    meta: dict[str, Any] = {"sh0": {"codebook": book.tolist(), "files": ["sh0.webp"]}}
    images = {"sh0.webp": _webp(np.concatenate([index, in_bytes(columns.opacities * 255)[:, None]], 1), width)}
    degree = min(isqrt(harmonics.shape[1]) - 1, DEGREE)
    if degree:
        rest = harmonics[:, 1 : (degree + 1) ** 2]
        centroids, labels = palette(rest.reshape(len(rest), -1))
        book, index = codebook(centroids)
        blocks = index.reshape(len(centroids), -1, 3)
        images["shN_centroids.webp"] = _webp(blocks.reshape(-1, 3), 64 * blocks.shape[1])
        images["shN_labels.webp"] = _webp(np.stack([labels & 255, labels >> 8, 0 * labels], 1), width)
        files = ["shN_centroids.webp", "shN_labels.webp"]
        meta["shN"] = {"count": len(centroids), "bands": degree, "codebook": book.tolist(), "files": files}
    return meta, images


def _width(count: int) -> int:
    return max(4, ceil(sqrt(count) / 4) * 4)


def _between(part: Mapping[str, Any], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fractions of the range of each channel of an attribute."""
    low, high = np.array(part.get("mins", 0.0)), np.array(part.get("maxs", 1.0))
    return low + (high - low) * values


def _leveled(part: Mapping[str, Any], index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Levels of an attribute: of its codebook, or evenly spaced between its bounds."""
    return np.array(part["codebook"])[index] if part.get("codebook") else _between(part, index / 255)


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    require(archive.getinfo(name).file_size, name, "a smaller file")
    return archive.read(name)


def palette(vectors: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vector quantisation: at most :data:`PALETTE` centroids, and the index of the centroid of each vector.

    Centroids start as a random sample; each vector is assigned to the nearest along the six principal directions, and
    the mean of its vectors replaces each centroid.
    """
    if len(vectors) <= PALETTE:
        return vectors, np.arange(len(vectors))
    centered = vectors - vectors.mean(0)
    directions = np.linalg.eigh(centered.T @ centered)[1][:, -6:]
    drawn = np.sort(np.random.default_rng(0).choice(len(vectors), PALETTE, replace=False))
    labels = np.asarray(KDTree(centered[drawn] @ directions).query(centered @ directions)[1])
    counts = np.bincount(labels, minlength=PALETTE)
    sums = np.stack([np.bincount(labels, column, PALETTE) for column in vectors.T], 1)
    return np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], vectors[drawn]), labels


def _webp(values: NDArray[np.generic], width: int) -> bytes:
    """Rows of three or four bytes as the pixels of a lossless WebP image, padded with zeros."""
    pixels = np.pad(values.astype(np.uint8), ((0, -len(values) % width), (0, 0))).reshape(-1, width, values.shape[1])
    stream = io.BytesIO()
    # `exact` keeps colours under transparent pixels.
    Image.fromarray(pixels).save(stream, "WEBP", lossless=True, exact=True, method=2)
    return stream.getvalue()
