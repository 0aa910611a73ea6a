"""Readers of exported files that share no code with what writes them: other packages, or the specifications."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import torch

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
    return _of_gsply(pytest.importorskip("gsply").plyread(str(path)))  # which has no wheel for Python 3.14


def read_spz_file(path: Path) -> Gaussians:
    """With gsply, in the file's axes."""
    return _of_gsply(pytest.importorskip("gsply.spz").read_spz(path))


def _of_gsply(data) -> Gaussians:
    """Its rows are those of a PLY file: logarithms of scales, logits of opacities."""
    rest = np.zeros((len(data.means), 0, 3)) if data.shN is None else data.shN
    return gaussians_of(
        data.means, data.quats, np.exp(data.scales), 1 / (1 + np.exp(-data.opacities)),
        np.concatenate([data.sh0[:, None], rest], 1),
    )  # fmt: skip


def read_with_splat_transform(path: Path, folder: Path) -> Gaussians:
    """Converted to PLY, in OpenCV's axes; it turns other formats to those of 3DGS, but not SPZ (as of 3.7.0)."""
    out = folder / f"{path.name}.ply"
    # Without a GPU, which compressing to SOG takes otherwise.
    words = [str(SPLAT_TRANSFORM), "-q", "-w", "-g", "cpu", str(path), str(out)]
    subprocess.run(words, check=True, capture_output=True)
    return from_axes("y" if path.suffix == ".spz" else "opencv", Gaussians.load(out))


def read_with_gaussforge(path: Path) -> Gaussians:
    """Converted to PLY; it turns no axes."""
    gaussforge = pytest.importorskip("gaussforge")
    out = path.with_suffix(f"{path.suffix}.ply")
    out.write_bytes(gaussforge.GaussForge().convert(path.read_bytes(), path.suffix[1:], "ply")["data"])
    return Gaussians.load(out)


READERS = {"ply": read_ply, "spz": read_spz_file, **dict.fromkeys(("sog", "splat", "ksplat"), read_with_gaussforge)}
"""In the file's axes."""
