"""SOG, version 2: quantised attributes as lossless WebP images and ``meta.json`` in one archive; version 1 is read.

The format is described in PlayCanvas's user manual (developer.playcanvas.com, "The SOG format"). Its axes are those of
3DGS PLY files: programs that read both rotate both alike.
"""

import io
import json
import zipfile
from dataclasses import dataclass, field
from math import ceil, isqrt, sqrt
from pathlib import Path

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import KDTree

from anystyle.contracts import Format
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parse_json
from anystyle.io.images import opened, require_pixels
from anystyle.io.limits import require
from anystyle.io.ply import MAX_DEGREE, from_smallest_three
from anystyle.io.splats import near
from anystyle.pipeline.provenance import tables
from anystyle.types import StyledScene
from anystyle_formats.packing import morton_order, smallest_three
from anystyle_formats.provenance import joined_notes, lines_of
from anystyle_formats.reading import gaussians, reading, room_for

PALETTE = 65_536
"""The format's limit on distinct sets of higher harmonics."""
_LEVELS = 256
_SCALE_FLOOR = 1e-12


class Sog(Format):
    """SOG, as PlayCanvas reads it: attributes as images in one ZIP file."""

    has_notes = reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        splats = scene.splats()
        order = morton_order(splats.means.detach().double().cpu().numpy())
        means, _, scales, opacities, harmonics = (tensor.detach().double().cpu().numpy()[order] for tensor in splats)
        far = np.sign(means) * np.log1p(np.abs(means))
        low, high = far.min(0), far.max(0)
        positions = np.round((far - low) / np.maximum(high - low, 1e-12) * 65535).astype(np.uint16)
        largest, others = smallest_three(F.normalize(splats.rotations.detach().double().cpu(), dim=-1).numpy()[order])
        scale_book, scale_index = codebook(np.log(np.maximum(scales, _SCALE_FLOOR)))
        color_book, color_index = codebook(harmonics[:, 0])
        alpha = np.round(opacities * 255).clip(0, 255)[:, None]
        quaternions = np.concatenate([np.round((others / sqrt(2) + 0.5) * 255), 252 + largest[:, None]], 1)
        pictures = {
            "means_l.webp": positions & 255,
            "means_u.webp": positions >> 8,
            "quats.webp": quaternions,
            "scales.webp": scale_index,
            "sh0.webp": np.concatenate([color_index, alpha], 1),
        }
        meta = {
            "version": 2,
            "asset": {
                "generator": "anystyle",
                "copyright": "\n".join(lines_of(scene.notes)),
                **({"provenance": made_of} if (made_of := tables(scene.notes)) else {}),
            },
            "count": len(means),
            "antialias": False,
            "means": {"mins": low.tolist(), "maxs": high.tolist(), "files": ["means_l.webp", "means_u.webp"]},
            "scales": {"codebook": scale_book.tolist(), "files": ["scales.webp"]},
            "quats": {"files": ["quats.webp"]},
            "sh0": {"codebook": color_book.tolist(), "files": ["sh0.webp"]},
        }
        width = max(4, ceil(sqrt(len(means)) / 4) * 4)
        images = {name: _webp(values, width) for name, values in pictures.items()}
        degree = min(isqrt(harmonics.shape[1]) - 1, MAX_DEGREE)
        if degree:
            rest = harmonics[:, 1 : (degree + 1) ** 2]
            centroids, labels = palette(rest.reshape(len(rest), -1))
            book, index = codebook(centroids)
            blocks = index.reshape(len(centroids), -1, 3)
            images["shN_centroids.webp"] = _webp(blocks.reshape(-1, 3), 64 * blocks.shape[1])
            images["shN_labels.webp"] = _webp(np.stack([labels & 255, labels >> 8, 0 * labels], 1), width)
            files = ["shN_centroids.webp", "shN_labels.webp"]
            meta["shN"] = {"count": len(centroids), "bands": degree, "codebook": book.tolist(), "files": files}
        with atomic_path(path) as temporary, zipfile.ZipFile(temporary, "w", zipfile.ZIP_STORED) as archive:
            for name, data in {"meta.json": json.dumps(meta).encode(), **images}.items():
                archive.writestr(zipfile.ZipInfo(name), data)

    def read(self, path: Path) -> StyledScene:
        with reading(path, "SOG file") as remarks, zipfile.ZipFile(path) as archive:
            meta = parse_json(_member(archive, "meta.json"), _Meta, source=str(path), what="SOG file")
            count = room_for(path, meta.count or meta.means.shape[0])

            def bytes_of(name: str, rows: int | None = count) -> NDArray[np.uint8]:
                """Pixels in RGBA, row by row: rows 4."""
                with opened(_member(archive, name), f"{path}: {name}") as image:
                    require_pixels(image, 1 << 16)
                    pixels = np.asarray(image.convert("RGBA")).reshape(-1, 4)
                if len(pixels) < (rows or 0):
                    raise ValueError(f"{name} has {len(pixels):,} pixels for {rows:,} Gaussians")
                return pixels[:rows]

            low, high = (bytes_of(name)[:, :3].astype(np.int64) for name in meta.means.files)
            far = meta.means.between((low | high << 8) / 65535)
            turns = bytes_of(meta.quats.files[0])
            wxyz = from_smallest_three(turns[:, 3].astype(np.int64) - 252, (turns[:, :3] / 255 - 0.5) * sqrt(2))
            color = bytes_of(meta.sh0.files[0])
            alpha = color[:, 3] / 255
            if not meta.sh0.codebook:
                alpha = 1 / (1 + np.exp(-meta.sh0.between(color / 255)[:, 3]))
            harmonics = meta.sh0.decoded(color)[:, None, :3]
            if meta.shN is not None:
                label, book = bytes_of(meta.shN.files[1]).astype(np.int64), bytes_of(meta.shN.files[0], None)
                with opened(_member(archive, meta.shN.files[0]), str(path)) as image:
                    columns = image.width // 64  # coefficients, side by side, of 64 centroids a row of pixels
                centroids = meta.shN.decoded(book[:, :3]).reshape(-1, columns, 3)
                harmonics = np.concatenate([harmonics, centroids[label[:, 0] | label[:, 1] << 8]], 1)
            scales = np.exp(meta.scales.decoded(bytes_of(meta.scales.files[0])[:, :3]))
            means, offset = near(np.sign(far) * np.expm1(np.abs(far)), remarks)
            scene = gaussians(remarks, means, wxyz, scales, alpha, harmonics)
        notes = joined_notes(str(meta.asset.get("copyright", "")).splitlines(), meta.asset.get("provenance"))
        return StyledScene(((path.stem, scene),), notes=notes, offset=offset)


@dataclass(frozen=True)
class _Part:
    """An attribute in ``meta.json``: files, and a codebook of 256 values, or bounds of evenly spaced ones."""

    files: list[str]
    mins: list[float] | float = 0.0
    maxs: list[float] | float = 1.0
    codebook: list[float] = field(default_factory=list)
    shape: list[int] = field(default_factory=lambda: [0])

    def between(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Fractions of the range of each channel."""
        low, high = np.array(self.mins), np.array(self.maxs)
        return low + (high - low) * values

    def decoded(self, index: NDArray[np.uint8]) -> NDArray[np.float64]:
        return np.array(self.codebook)[index] if self.codebook else self.between(index / 255)


@dataclass(frozen=True)
class _Meta:
    """``meta.json``; version 1 has the count in the shape of the means, and no codebooks."""

    means: _Part
    scales: _Part
    quats: _Part
    sh0: _Part
    shN: _Part | None = None
    count: int = 0
    asset: dict[str, object] = field(default_factory=dict)


def _member(archive: zipfile.ZipFile, name: str) -> bytes:
    require(archive.getinfo(name).file_size, name, "a smaller file")
    return archive.read(name)


def codebook(values: NDArray[np.float64], rounds: int = 32) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Scalar quantisation: 256 ascending levels by Lloyd's algorithm, and the index of the level of each value.

    Half of the levels start at quantiles, which cover the bulk, half evenly spaced, which covers outliers.
    """
    flat = np.sort(values.ravel())
    half = _LEVELS // 2
    steps = np.linspace(flat[0], flat[-1], half)
    levels = np.sort(np.concatenate([np.quantile(flat, (np.arange(half) + 0.5) / half), steps]))
    sums = np.concatenate([[0.0], np.cumsum(flat)])
    for _ in range(rounds):
        edges = np.searchsorted(flat, (levels[1:] + levels[:-1]) / 2)
        bounds = np.concatenate([[0], edges, [len(flat)]])
        counts = np.diff(bounds)
        means = (sums[bounds[1:]] - sums[bounds[:-1]]) / np.maximum(counts, 1)
        levels = np.sort(np.where(counts > 0, means, levels))
    index = np.searchsorted((levels[1:] + levels[:-1]) / 2, values)
    return levels, index.astype(np.uint8)


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
    height = max(1, -(-len(values) // width))
    pixels = np.zeros((height * width, values.shape[1]), np.uint8)
    pixels[: len(values)] = values
    stream = io.BytesIO()
    # `exact` keeps colours under transparent pixels.
    Image.fromarray(pixels.reshape(height, width, -1)).save(stream, "WEBP", lossless=True, exact=True, method=4)
    return stream.getvalue()
