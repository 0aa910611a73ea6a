"""Binary glTF 2.0 with the extension KHR_gaussian_splatting of Khronos.

Gaussians are points with linear scales, opacities in [0, 1] and quaternions xyzw; glTF's axes are y up. Viewers that
do not know the extension show ``COLOR_0``.
"""

import json
import struct
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
import torch.nn.functional as F
from numpy.typing import NDArray

from anystyle.contracts import Format
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.io.atomic import atomic_path
from anystyle.io.ply import MAX_DEGREE, Splats
from anystyle.types import StyledScene

NAME = "KHR_gaussian_splatting"
_FLOAT, _UNSIGNED_BYTE, _POINTS, _ARRAY_BUFFER = 5126, 5121, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


class Glb(Format):
    """Binary glTF 2.0 with the extension ``KHR_gaussian_splatting``."""

    up = "y"
    has_notes = True

    def write(self, scene: StyledScene, path: Path) -> None:
        attributes = _attributes(scene.splats())
        accessors: list[dict[str, object]] = []
        views: list[dict[str, object]] = []
        binary = b""
        for index, (name, values) in enumerate(attributes.items()):
            data = values.tobytes()
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": _ARRAY_BUFFER})
            accessor = {"bufferView": index, "count": len(values), "type": _TYPES[values.shape[1]]}
            if values.dtype == np.uint8:
                accessor |= {"componentType": _UNSIGNED_BYTE, "normalized": True}
            else:
                accessor |= {"componentType": _FLOAT}
            if name == "POSITION":
                accessor |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
            accessors.append(accessor)
            binary += data + b"\0" * (-len(data) % 4)
        splatting = {
            "kernel": "ellipse",
            "colorSpace": "srgb_rec709_display",
            "sortingMethod": "cameraDistance",
            "projection": "perspective",
        }
        primitive = {
            "attributes": {name: index for index, name in enumerate(attributes)},
            "mode": _POINTS,
            "extensions": {NAME: splatting},
        }
        document = {
            "asset": {"version": "2.0", "generator": "anystyle", "copyright": "\n".join(scene.notes)},
            "extensionsUsed": [NAME],
            "scene": 0,
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [{"primitives": [primitive]}],
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": views,
            "accessors": accessors,
        }
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        with atomic_path(path) as temporary:
            temporary.write_bytes(
                struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
                + struct.pack("<I4s", len(text), b"JSON") + text
                + struct.pack("<I4s", len(binary), b"BIN\0") + binary
            )  # fmt: skip


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Vertex attributes by name, in the order of the file: float32 or uint8, ``N`` rows."""
    means, rotations, scales, opacities, harmonics = (tensor.detach().float().cpu() for tensor in splats)
    rgb = rgb_from_constant(harmonics[:, 0]).clamp(0, 1)
    color = np.concatenate([rgb.numpy(), opacities[:, None].clamp(0, 1).numpy()], 1)
    columns: dict[str, NDArray[Any]] = {
        "POSITION": means.numpy(),
        "COLOR_0": (color * 255).round().astype(np.uint8),
        f"{NAME}:ROTATION": F.normalize(rotations, dim=-1)[:, [1, 2, 3, 0]].numpy(),
        f"{NAME}:SCALE": scales.numpy(),
        f"{NAME}:OPACITY": opacities[:, None].clamp(0, 1).numpy(),
    }
    for degree in range(min(isqrt(harmonics.shape[1]) - 1, MAX_DEGREE) + 1):
        for order in range(2 * degree + 1):
            columns[f"{NAME}:SH_DEGREE_{degree}_COEF_{order}"] = harmonics[:, degree * degree + order].numpy()
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}
