"""Binary glTF 2.0 with the extension KHR_gaussian_splatting, as Khronos ratified it.

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

from anystyle.io.atomic import atomic_path
from anystyle.io.ply import MAX_DEGREE, Splats

CONSTANT = 0.28209479177387814
NAME = "KHR_gaussian_splatting"
_FLOAT, _UNSIGNED_BYTE, _POINTS, _ARRAY_BUFFER = 5126, 5121, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}


def write(splats: Splats, path: Path, notes: str = "") -> None:
    """Write one scene in y-up axes, whole or not at all; notes, such as licences, are the asset's ``copyright``."""
    attributes = _attributes(splats)
    accessors: list[dict[str, object]] = []
    views: list[dict[str, object]] = []
    binary = b""
    for index, (name, values) in enumerate(attributes.items()):
        data = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data), "target": _ARRAY_BUFFER})
        byte = values.dtype == np.uint8
        accessors.append(
            {
                "bufferView": index,
                "componentType": _UNSIGNED_BYTE if byte else _FLOAT,
                "count": len(values),
                "type": _TYPES[values.shape[1]],
                **({"normalized": True} if byte else {}),
                **(
                    {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
                    if name == "POSITION" and len(values)
                    else {}
                ),
            }
        )
        binary += data + b"\0" * (-len(data) % 4)
    primitive = {
        "attributes": {name: index for index, name in enumerate(attributes)},
        "mode": _POINTS,
        "extensions": {
            NAME: {
                "kernel": "ellipse",
                "colorSpace": "srgb_rec709_display",
                "sortingMethod": "cameraDistance",
                "projection": "perspective",
            }
        },
    }
    document = {
        "asset": {"version": "2.0", "generator": "anystyle", **({"copyright": notes} if notes else {})},
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
    """Columns by name, in the order of the file."""
    means, rotations, scales, opacities, harmonics = (tensor.detach().float().cpu() for tensor in splats)
    rgb = (harmonics[:, 0] * CONSTANT + 0.5).clamp(0, 1)
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
