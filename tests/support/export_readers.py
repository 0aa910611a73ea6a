"""Readers of exported files that share no code with what writes them: other packages, or the specifications."""

import io
import json
import shutil
import subprocess
import zipfile
from importlib.util import find_spec
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


def read_glb(path: Path) -> Gaussians:
    """With pygltflib, in the file's axes."""
    from pygltflib import GLTF2

    document = GLTF2().load(str(path))
    assert document is not None and "KHR_gaussian_splatting" in (document.extensionsUsed or [])
    (primitive,) = document.meshes[0].primitives
    assert primitive.mode == 0 and primitive.extensions["KHR_gaussian_splatting"]["kernel"] == "ellipse"
    blob = document.binary_blob()

    def column(name):
        accessor = document.accessors[getattr(primitive.attributes, name)]
        view = document.bufferViews[accessor.bufferView]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
        assert accessor.componentType == 5126
        values = np.frombuffer(blob, "<f4", accessor.count * width, view.byteOffset).reshape(-1, width)
        if accessor.min:
            np.testing.assert_array_equal([accessor.min, accessor.max], [values.min(0), values.max(0)])
        return values

    stem = "KHR_gaussian_splatting:"
    degrees = [int(name.split("_")[-3]) for name in vars(primitive.attributes) if name.startswith(f"{stem}SH_DEGREE")]
    harmonics = [
        column(f"{stem}SH_DEGREE_{degree}_COEF_{order}")
        for degree in range(max(degrees) + 1)
        for order in range(2 * degree + 1)
    ]
    return gaussians_of(
        column("POSITION"), column(f"{stem}ROTATION")[:, [3, 0, 1, 2]], column(f"{stem}SCALE"),
        column(f"{stem}OPACITY")[:, 0], np.stack(harmonics, 1),
    )  # fmt: skip


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


def read_usd(path: Path) -> Gaussians:
    """With OpenUSD, in the axes of a stage without transformations."""
    from pxr import Usd

    stage = Usd.Stage.Open(str(path))
    field = stage.GetPrimAtPath("/Scene/Gaussians")
    means, scales, opacities, harmonics = (
        np.array(field.GetAttribute(name).Get())
        for name in ("positions", "scales", "opacities", "radiance:sphericalHarmonicsCoefficients")
    )
    quaternions = [[each.GetReal(), *each.GetImaginary()] for each in field.GetAttribute("orientations").Get()]
    return gaussians_of(means, quaternions, scales, opacities, harmonics.reshape(len(means), -1, 3))


def read_with_splat_transform(path: Path, folder: Path) -> Gaussians:
    """Converted to PLY, in OpenCV's axes; it turns other formats to those of 3DGS, but not SPZ (as of 3.7.0)."""
    out = folder / f"{path.name}.ply"
    with_splat_transform(path, out)
    return from_axes("y" if path.suffix == ".spz" else "opencv", Gaussians.load(out))


def with_splat_transform(source: Path, target: Path) -> None:
    """Convert a file; without a GPU, which compressing to SOG takes otherwise."""
    words = [str(SPLAT_TRANSFORM), "-q", "-w", "-g", "cpu", str(source), str(target)]
    subprocess.run(words, check=True, capture_output=True)


def with_gaussforge(source: Path, target: Path) -> None:
    """Convert a file; it turns no axes."""
    import gaussforge

    kinds = source.suffix[1:], target.suffix[1:]
    target.write_bytes(gaussforge.GaussForge().convert(source.read_bytes(), *kinds)["data"])


def read_with_gaussforge(path: Path, folder: Path) -> Gaussians:
    """Converted to PLY, in OpenCV's axes."""
    out = folder / f"{path.name}.gaussforge.ply"
    with_gaussforge(path, out)
    return from_axes("y" if path.suffix == ".spz" else "opencv", Gaussians.load(out))


READERS = {"glb": read_glb, "spz": read_spz_file, "splat": read_splat, "sog": read_sog, "ply": read_ply}
if find_spec("pxr") is not None:
    READERS["usdc"] = read_usd
