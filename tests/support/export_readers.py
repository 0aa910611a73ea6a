"""Readers of exported files that share no code with what writes them: other packages, or the specifications."""

import io
import json
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.pipeline.export import in_axes
from anystyle.types import Gaussians, StyledScene

SPLAT_TRANSFORM = shutil.which("splat-transform")
"""PlayCanvas's converter (npm install -g @playcanvas/splat-transform); reads SPZ with Niantic's own decoder."""


def gaussians_of(means, rotations, scales, opacities, harmonics):
    columns = (means, rotations, scales, opacities, harmonics)
    return Gaussians(*(torch.from_numpy(np.array(column, np.float32))[None] for column in columns))


def from_axes(up, gaussians: Gaussians) -> Gaussians:
    """Turned to OpenCV's axes."""
    return in_axes("opencv", StyledScene((("", gaussians),), up=up)).styles[0][1]


def read_ply(path: Path) -> Gaussians:
    """With gsply."""
    gsply = pytest.importorskip("gsply")  # has no wheel for Python 3.14
    return _of_gsply(gsply.plyread(str(path)))


def read_spz_file(path: Path) -> Gaussians:
    """With gsply, in the file's axes."""
    spz = pytest.importorskip("gsply.spz")
    return _of_gsply(spz.read_spz(path))


def _of_gsply(data) -> Gaussians:
    """Its rows are those of a PLY file: logarithms of scales, logits of opacities."""
    rest = np.zeros((len(data.means), 0, 3)) if data.shN is None else data.shN
    return gaussians_of(
        data.means, data.quats, np.exp(data.scales), 1 / (1 + np.exp(-data.opacities)),
        np.concatenate([data.sh0[:, None], rest], 1),
    )  # fmt: skip


def read_splat(path: Path) -> Gaussians:
    """As github.com/antimatter15/splat describes its rows."""
    raw = np.frombuffer(path.read_bytes(), np.uint8).reshape(-1, 32)
    floats = raw[:, :24].copy().view("<f4")
    color = raw[:, 24:28] / 255
    quaternion = (raw[:, 28:32].astype(float) - 128) / 128
    harmonics = (color[:, :3] - 0.5) / 0.28209479177387814
    return gaussians_of(floats[:, :3], quaternion, floats[:, 3:6], color[:, 3], harmonics[:, None])


def read_sog(path: Path) -> Gaussians:
    """As PlayCanvas's specification of version 2 says, pixel by pixel."""
    with zipfile.ZipFile(path) as archive:
        meta = json.loads(archive.read("meta.json"))
        assert meta["version"] == 2

        def pixels(name):
            picture = Image.open(io.BytesIO(archive.read(name)))
            assert picture.format == "WEBP"
            return np.asarray(picture.convert("RGBA")).reshape(-1, 4).astype(np.int64)

        n = meta["count"]
        low, high = pixels(meta["means"]["files"][0])[:n, :3], pixels(meta["means"]["files"][1])[:n, :3]
        mins, maxs = np.array(meta["means"]["mins"]), np.array(meta["means"]["maxs"])
        far = mins + (maxs - mins) * (low + 256 * high) / 65535
        means = np.sign(far) * (np.exp(np.abs(far)) - 1)
        scales = np.exp(np.array(meta["scales"]["codebook"])[pixels(meta["scales"]["files"][0])[:n, :3]])
        packed = pixels(meta["quats"]["files"][0])[:n]
        quaternions = np.zeros((n, 4))
        for row in range(n):
            largest = packed[row, 3] - 252
            small = (packed[row, :3] / 255 - 0.5) * 2 / np.sqrt(2)
            quaternions[row] = np.insert(small, largest, np.sqrt(max(0, 1 - small @ small)))
        color = pixels(meta["sh0"]["files"][0])[:n]
        harmonics = [np.array(meta["sh0"]["codebook"])[color[:, :3]][:, None]]
        if "shN" in meta:
            centroids, labels = (pixels(name) for name in meta["shN"]["files"])
            label = labels[:n, 0] + 256 * labels[:n, 1]
            count = {1: 3, 2: 8, 3: 15}[meta["shN"]["bands"]]
            book = np.array(meta["shN"]["codebook"])
            where = (label // 64)[:, None] * 64 * count + (label % 64)[:, None] * count + np.arange(count)
            harmonics.append(book[centroids[where, :3]])
    return gaussians_of(means, quaternions, scales, color[:, 3] / 255, np.concatenate(harmonics, 1))


def read_with_splat_transform(path: Path, folder: Path) -> Gaussians:
    """Converted to PLY, in OpenCV's axes; it turns other formats to those of 3DGS, but not SPZ (as of 3.7.0)."""
    out = folder / f"{path.name}.ply"
    # Without a GPU, which compressing to SOG takes otherwise.
    words = [str(SPLAT_TRANSFORM), "-q", "-w", "-g", "cpu", str(path), str(out)]
    subprocess.run(words, check=True, capture_output=True)
    return from_axes("y" if path.suffix == ".spz" else "opencv", Gaussians.load(out))


def read_with_gaussforge(path: Path, folder: Path) -> Gaussians:
    """Converted to PLY, in OpenCV's axes; it turns none."""
    import gaussforge

    out = folder / f"{path.name}.gaussforge.ply"
    out.write_bytes(gaussforge.GaussForge().convert(path.read_bytes(), path.suffix[1:], "ply")["data"])
    return from_axes("y" if path.suffix == ".spz" else "opencv", Gaussians.load(out))


READERS = {"ply": read_ply, "spz": read_spz_file, "sog": read_sog, "splat": read_splat}
