"""Binary glTF 2.0 with the extension KHR_gaussian_splatting of Khronos.

Gaussians are points with linear scales, opacities in [0, 1] and quaternions xyzw; glTF's axes are y up. Viewers that
do not know the extension show ``COLOR_0``.

Each style is a scene of the file, the last the one that is shown; all share positions, and whatever else they have in
common. Variants of materials would not do: the extension ignores materials.
"""

import json
import struct
from collections.abc import Iterator, Mapping
from math import isqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.contracts import Format
from anystyle.geometry.harmonics import CONSTANT
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parse_json
from anystyle.io.ply import MAX_DEGREE
from anystyle.io.splats import Remarks, Splats
from anystyle.types import Gaussians, StyledScene
from anystyle_formats import spz
from anystyle_formats.packing import columns_of, in_bytes
from anystyle_formats.reading import Placed, gaussians, joined, offset_of_parts, reading, room_for

NAME, PACKED = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"
_KERNEL = {
    "kernel": "ellipse", "colorSpace": "srgb_rec709_display",
    "sortingMethod": "cameraDistance", "projection": "perspective",
}  # fmt: skip
_FLOAT, _UNSIGNED_BYTE, _POINTS, _ARRAY_BUFFER = 5126, 5121, 0, 34962
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_JSON, _BIN = b"JSON", b"BIN\0"


class Glb(Format):
    """Binary glTF 2.0 with the extension ``KHR_gaussian_splatting``; each style is a scene of it."""

    up = "y"
    has_notes = has_offset = many_styles = reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        titles, stored = [title for title, _ in scene.styles], _Buffer([], [], bytearray(), {})
        meshes = []
        for style, title in enumerate(titles):
            columns = _attributes(scene.splats(style))
            attributes = {name: stored.accessor(values, name) for name, values in columns.items()}
            primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {NAME: _KERNEL}}
            meshes.append({"name": title, "primitives": [primitive]})
        asset: dict[str, Any] = {"version": "2.0", "generator": "anystyle"}
        asset["copyright"] = "\n".join(scene.notes)
        placed = {"translation": list(scene.offset)} if any(scene.offset) else {}
        document = {
            "asset": asset,
            "extensionsUsed": [NAME],
            "scene": len(titles) - 1,
            "scenes": [{"name": title, "nodes": [style]} for style, title in enumerate(titles)],
            "nodes": [{"name": title, "mesh": style} | placed for style, title in enumerate(titles)],
            "meshes": meshes,
            "buffers": [{"byteLength": len(stored.binary)}],
            "bufferViews": stored.views,
            "accessors": stored.accessors,
        }
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        parts = ((_JSON, text), (_BIN, stored.binary))
        chunks = b"".join(struct.pack("<I4s", len(data), kind) + data for kind, data in parts)
        with atomic_path(path) as temporary:
            temporary.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)

    def read(self, path: Path) -> StyledScene:
        with reading(path, "GLB file") as remarks:
            chunks = dict(_chunks(path.read_bytes()))
            document = parse_json(chunks[_JSON], dict[str, Any], source=str(path), what="GLB file")
            file, shown = _GlbFile(remarks, document, chunks.get(_BIN, b"")), document.get("scene", 0)
            order = [index for index in range(len(document["scenes"])) if index != shown]
            scenes = {index: file.scene(index) for index in [*order, shown]}
            if not scenes[shown]:
                raise ValueError(f"what it shows has no primitive with the extension {NAME}")
            offset = offset_of_parts(scenes[shown], remarks)
            found = tuple(
                (str(document["scenes"][index].get("name") or path.stem), joined(parts, offset))
                for index, parts in scenes.items()
                if parts
            )
            asset = document["asset"]
            if not str(asset["version"]).startswith("2."):
                raise ValueError(f"it is of glTF {asset['version']}, and 2.0 is read")
            notes = tuple(str(asset.get("copyright", "")).splitlines())
        return StyledScene(found, notes=notes, up=self.up, offset=offset)


class _Buffer(NamedTuple):
    """What accessors of a file are made of; styles share what they have in common."""

    accessors: list[dict[str, object]]
    views: list[dict[str, object]]
    binary: bytearray
    known: dict[bytes, int]

    def accessor(self, values: NDArray[Any], name: str) -> int:
        """The index of the accessor of some values."""
        data = values.tobytes()
        if data in self.known:
            return self.known[data]
        start = {"byteOffset": len(self.binary), "byteLength": len(data)}
        self.views.append({"buffer": 0, **start, "target": _ARRAY_BUFFER})
        kind = next(kind for kind, width in _WIDTHS.items() if width == values.shape[1])
        entry: dict[str, object] = {"bufferView": len(self.views) - 1, "count": len(values), "type": kind}
        color = values.dtype == np.uint8
        entry |= {"componentType": _UNSIGNED_BYTE, "normalized": True} if color else {"componentType": _FLOAT}
        if name == "POSITION":
            entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
        self.accessors.append(entry)
        self.binary.extend(data + b"\0" * (-len(data) % 4))
        return self.known.setdefault(data, len(self.accessors) - 1)


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Vertex attributes by name, in the order of the file: float32 or uint8, ``N`` rows."""
    means, rotations, scales, opacities, harmonics = columns_of(splats, torch.float32)
    rgb = (harmonics[:, 0] * CONSTANT + 0.5).clip(0, 1)
    linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)  # as vertex colours are
    alpha = opacities[:, None].clip(0, 1)
    columns: dict[str, NDArray[Any]] = {
        "POSITION": means,
        "COLOR_0": in_bytes(np.concatenate([linear, alpha], 1) * 255),
        f"{NAME}:ROTATION": rotations[:, [1, 2, 3, 0]],
        f"{NAME}:SCALE": scales,
        f"{NAME}:OPACITY": alpha,
    }
    degree = min(isqrt(harmonics.shape[1]) - 1, MAX_DEGREE)
    columns |= {name: harmonics[:, row] for row, name in enumerate(_coefficients(degree))}
    return {name: np.ascontiguousarray(values) for name, values in columns.items()}


def _coefficients(most: int) -> list[str]:
    """The attributes of harmonics up to a degree."""
    return [f"{NAME}:SH_DEGREE_{degree}_COEF_{order}" for degree in range(most + 1) for order in range(2 * degree + 1)]


class _GlbFile(NamedTuple):
    """A file whose JSON is read as it is: what is missing or of another type ends in an error of :func:`reading`."""

    remarks: Remarks
    document: Mapping[str, Any]
    binary: bytes

    def scene(self, index: int) -> list[Placed]:
        """All Gaussians of a scene of the file."""
        roots = self.document["scenes"][index].get("nodes", ())
        return [part for root in roots for part in self._below(root, np.eye(4), 0)]

    def _below(self, index: int, parent: NDArray[np.float64], depth: int) -> Iterator[Placed]:
        if depth > len(self.document["nodes"]):
            raise ValueError("its nodes are their own children")
        node = self.document["nodes"][index]
        world = parent @ _transformation(node)
        for primitive in self.document["meshes"][node["mesh"]]["primitives"] if "mesh" in node else ():
            if NAME in primitive.get("extensions", ()):
                yield self._splats(primitive.get("attributes", {}), primitive["extensions"][NAME]), world
        for child in node.get("children", ()):
            yield from self._below(child, world, depth + 1)

    def _splats(self, given: Mapping[str, int], how: Mapping[str, Any]) -> Gaussians:
        if how.get("kernel") != _KERNEL["kernel"] or how.get("colorSpace") != _KERNEL["colorSpace"]:
            raise ValueError(f"kernel {how.get('kernel')!r} in {how.get('colorSpace')!r}; ellipses in sRGB are read")
        if PACKED in how.get("extensions", {}):
            return spz.decoded(self._view(how["extensions"][PACKED]["bufferView"]), self.remarks)
        degree = max((int(name.split("_")[-3]) for name in given if ":SH_DEGREE_" in name), default=0)
        return gaussians(
            self.remarks,
            self._column(given["POSITION"]),
            self._column(given[f"{NAME}:ROTATION"])[:, [3, 0, 1, 2]],
            self._column(given[f"{NAME}:SCALE"]),
            self._column(given[f"{NAME}:OPACITY"])[:, 0],
            np.stack([self._column(given[name]) for name in _coefficients(min(degree, MAX_DEGREE))], 1),
        )

    def _view(self, index: int) -> bytes:
        view = self.document["bufferViews"][index]
        return self.binary[view.get("byteOffset", 0) :][: view["byteLength"]]

    def _column(self, index: int) -> NDArray[np.float64]:
        """The values of an accessor, one row per element."""
        entry = self.document["accessors"][index]
        if "sparse" in entry or "bufferView" not in entry:
            raise ValueError("sparse accessors are not read")
        width, kind = _WIDTHS[entry["type"]], np.dtype(_COMPONENTS[entry["componentType"]])
        stride = self.document["bufferViews"][entry["bufferView"]].get("byteStride") or width * kind.itemsize
        shape, start = (room_for(self.remarks.path, entry["count"]), width), entry.get("byteOffset", 0)
        values = np.ndarray(shape, kind, self._view(entry["bufferView"]), start, (stride, kind.itemsize))
        return values.astype(np.float64) / (np.iinfo(kind).max if entry.get("normalized") else 1)


def _transformation(node: Mapping[str, Any]) -> NDArray[np.float64]:
    """A node's own transformation: 4 4."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    whole = np.eye(4)
    turn = Rotation.from_quat(node.get("rotation", (0, 0, 0, 1))).as_matrix()
    whole[:3, :3] = turn * np.reshape(node.get("scale", (1, 1, 1)), 3)
    whole[:3, 3] = np.reshape(node.get("translation", (0, 0, 0)), 3)
    return whole


def _chunks(data: bytes) -> Iterator[tuple[bytes, bytes]]:
    """The chunks of a file by their type."""
    magic, version, length = struct.unpack_from("<4sII", data)
    if magic != b"glTF" or version != 2:
        raise ValueError("its header is not that of version 2")
    at = 12
    while at + 8 <= min(length, len(data)):
        size, kind = struct.unpack_from("<I4s", data, at)
        yield kind, data[at + 8 : at + 8 + size]
        at += 8 + size
