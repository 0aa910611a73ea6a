"""Binary glTF 2.0 with the extension KHR_gaussian_splatting of Khronos.

Gaussians are points with linear scales, opacities in [0, 1] and quaternions xyzw; glTF's axes are y up. Viewers that
do not know the extension show ``COLOR_0``.

Each style is a scene of the file, the last the one that is shown; all share positions, and whatever else they have in
common. Variants of materials would not do: the extension ignores materials.
"""

import json
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from math import isqrt
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from anystyle.contracts import Format
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parse_json
from anystyle.io.ply import MAX_DEGREE
from anystyle.io.splats import Remarks, Splats
from anystyle.pipeline.provenance import tables
from anystyle.types import Gaussians, StyledScene
from anystyle_formats import spz
from anystyle_formats.provenance import XMP, joined_notes, lines_of, xmp_packet
from anystyle_formats.reading import Placed, gaussians, joined, moved, offset_of_parts, reading, room_for

NAME, PACKED = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"
_FLOAT, _UNSIGNED_BYTE, _POINTS, _ARRAY_BUFFER = 5126, 5121, 0, 34962
_TYPES = {1: "SCALAR", 3: "VEC3", 4: "VEC4"}
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_JSON, _BIN = b"JSON", b"BIN\0"


class Glb(Format):
    """Binary glTF 2.0 with the extension ``KHR_gaussian_splatting``; each style is a scene of it."""

    up = "y"
    has_notes = has_offset = many_styles = reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        accessors: list[dict[str, object]] = []
        views: list[dict[str, object]] = []
        parts: list[bytes] = []
        known: dict[bytes, int] = {}

        def accessor(values: NDArray[Any], name: str) -> int:
            """The index of an accessor; styles share what they have in common."""
            data = values.tobytes()
            if data in known:
                return known[data]
            start = sum(map(len, parts))
            views.append({"buffer": 0, "byteOffset": start, "byteLength": len(data), "target": _ARRAY_BUFFER})
            entry: dict[str, object] = {"bufferView": len(views) - 1, "count": len(values)}
            entry |= {"type": _TYPES[values.shape[1]], "componentType": _FLOAT}
            if values.dtype == np.uint8:
                entry |= {"componentType": _UNSIGNED_BYTE, "normalized": True}
            if name == "POSITION":
                entry |= {"min": values.min(0).tolist(), "max": values.max(0).tolist()}
            accessors.append(entry)
            parts.append(data + b"\0" * (-len(data) % 4))
            return known.setdefault(data, len(accessors) - 1)

        titles, kernel = (
            [title for title, _ in scene.styles],
            {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"},
        )
        kernel |= {"sortingMethod": "cameraDistance", "projection": "perspective"}
        meshes: list[dict[str, object]] = []
        for style, title in enumerate(titles):
            columns = _attributes(scene.splats(style))
            attributes = {name: accessor(values, name) for name, values in columns.items()}
            primitive = {"attributes": attributes, "mode": _POINTS, "extensions": {NAME: kernel}}
            meshes.append({"name": title, "primitives": [primitive]})
        binary = b"".join(parts)
        asset: dict[str, Any] = {"version": "2.0", "generator": "anystyle"}
        asset["copyright"] = "\n".join(lines_of(scene.notes))
        packet = xmp_packet(scene, "model/gltf-binary")
        if packet is not None:
            asset |= {"extensions": {XMP: {"packet": 0}}, "extras": {"provenance": tables(scene.notes)}}
        placed = {"translation": list(scene.offset)} if any(scene.offset) else {}
        document = {
            "asset": asset,
            "extensionsUsed": [NAME, *([XMP] if packet else [])],
            **({"extensions": {XMP: {"packets": [packet]}}} if packet else {}),
            "scene": len(titles) - 1,
            "scenes": [{"name": title, "nodes": [style]} for style, title in enumerate(titles)],
            "nodes": [{"name": title, "mesh": style} | placed for style, title in enumerate(titles)],
            "meshes": meshes,
            "buffers": [{"byteLength": len(binary)}],
            "bufferViews": views,
            "accessors": accessors,
        }
        text = json.dumps(document).encode()
        text += b" " * (-len(text) % 4)
        with atomic_path(path) as temporary:
            temporary.write_bytes(
                struct.pack("<4sII", b"glTF", 2, 12 + 8 + len(text) + 8 + len(binary))
                + struct.pack("<I4s", len(text), _JSON) + text
                + struct.pack("<I4s", len(binary), _BIN) + binary
            )  # fmt: skip

    def read(self, path: Path) -> StyledScene:
        with reading(path, "GLB file") as remarks:
            chunks = dict(_chunks(path.read_bytes()))
            document = parse_json(chunks[_JSON], _Document, source=str(path), what="GLB file")
            file = _GlbFile(remarks, document, chunks.get(_BIN, b""))
            shown = document.scene if document.scene is not None else 0
            order = [index for index in range(len(document.scenes)) if index != shown]
            scenes = {index: file.scene(index) for index in [*order, shown]}
            if not scenes[shown]:
                raise ValueError(f"what it shows has no primitive with the extension {NAME}")
            offset = offset_of_parts(scenes[shown], remarks)
            found = {
                index: joined([moved(*part, offset) for part in parts]) for index, parts in scenes.items() if parts
            }
            styles = [(document.scenes[index].name or path.stem, scene) for index, scene in found.items()]
        alike = tuple(style for style in styles if style[1].means.shape == styles[-1][1].means.shape)
        extras = document.asset.extras if isinstance(document.asset.extras, dict) else {}
        notes = joined_notes(document.asset.copyright.splitlines(), extras.get("provenance"))
        return StyledScene(alike, notes=notes, up=self.up, offset=offset)


def _attributes(splats: Splats) -> dict[str, NDArray[Any]]:
    """Vertex attributes by name, in the order of the file: float32 or uint8, ``N`` rows."""
    means, rotations, scales, opacities, harmonics = (tensor.detach().float().cpu() for tensor in splats)
    rgb = rgb_from_constant(harmonics[:, 0]).clamp(0, 1)
    linear = torch.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)  # as vertex colours are
    color = np.concatenate([linear.numpy(), opacities[:, None].clamp(0, 1).numpy()], 1)
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


# What is read of a document; names are glTF's.


@dataclass(frozen=True)
class _Accessor:
    count: int
    type: str
    componentType: int
    bufferView: int | None = None
    byteOffset: int = 0
    normalized: bool = False
    sparse: object = None


@dataclass(frozen=True)
class _View:
    byteLength: int
    byteOffset: int = 0
    byteStride: int = 0


@dataclass(frozen=True)
class _Primitive:
    attributes: dict[str, int] = field(default_factory=dict)
    extensions: dict[str, dict[str, Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class _Mesh:
    primitives: list[_Primitive]


@dataclass(frozen=True)
class _Node:
    mesh: int | None = None
    children: list[int] = field(default_factory=list)
    matrix: list[float] | None = None
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    scale: tuple[float, float, float] = (1.0, 1.0, 1.0)

    def local(self) -> NDArray[np.float64]:
        """The node's own transformation: 4 4."""
        if self.matrix is not None:
            return np.array(self.matrix).reshape(4, 4).T
        whole = np.eye(4)
        whole[:3, :3] = Rotation.from_quat(self.rotation).as_matrix() * self.scale
        whole[:3, 3] = self.translation
        return whole


@dataclass(frozen=True)
class _Roots:
    nodes: list[int] = field(default_factory=list)
    name: str = ""


@dataclass(frozen=True)
class _Asset:
    version: str
    copyright: str = ""
    extras: Any = None


@dataclass(frozen=True)
class _Document:
    asset: _Asset
    scenes: list[_Roots]
    nodes: list[_Node]
    meshes: list[_Mesh]
    accessors: list[_Accessor] = field(default_factory=list)
    bufferViews: list[_View] = field(default_factory=list)
    scene: int | None = None


@dataclass(frozen=True)
class _GlbFile:
    remarks: Remarks
    document: _Document
    binary: bytes

    def scene(self, index: int) -> list[Placed]:
        """All Gaussians of a scene of the file."""
        return [part for root in self.document.scenes[index].nodes for part in self._below(root, np.eye(4), 0)]

    def _below(self, index: int, parent: NDArray[np.float64], depth: int) -> Iterator[Placed]:
        if depth > len(self.document.nodes):
            raise ValueError("its nodes are their own children")
        node = self.document.nodes[index]
        world = parent @ node.local()
        for primitive in self.document.meshes[node.mesh].primitives if node.mesh is not None else []:
            if NAME in primitive.extensions:
                yield self._splats(primitive, primitive.extensions[NAME]), world
        for child in node.children:
            yield from self._below(child, world, depth + 1)

    def _splats(self, primitive: _Primitive, how: Mapping[str, Any]) -> Gaussians:
        if how.get("kernel") != "ellipse" or how.get("colorSpace") != "srgb_rec709_display":
            raise ValueError(f"kernel {how.get('kernel')!r} in {how.get('colorSpace')!r}; ellipses in sRGB are read")
        if PACKED in how.get("extensions", {}):
            view = self.document.bufferViews[how["extensions"][PACKED]["bufferView"]]
            return spz.decoded(self.binary[view.byteOffset : view.byteOffset + view.byteLength], self.remarks)
        given = primitive.attributes
        degrees = [degree for degree in range(MAX_DEGREE + 1) if f"{NAME}:SH_DEGREE_{degree}_COEF_0" in given]
        names = [f"{NAME}:SH_DEGREE_{degree}_COEF_{order}" for degree in degrees for order in range(2 * degree + 1)]
        return gaussians(
            self.remarks,
            self._column(given["POSITION"]),
            self._column(given[f"{NAME}:ROTATION"])[:, [3, 0, 1, 2]],
            self._column(given[f"{NAME}:SCALE"]),
            self._column(given[f"{NAME}:OPACITY"])[:, 0],
            np.stack([self._column(given[name]) for name in names], 1),
        )

    def _column(self, index: int) -> NDArray[np.float64]:
        """The values of an accessor, one row an element."""
        entry = self.document.accessors[index]
        if entry.sparse is not None or entry.bufferView is None:
            raise ValueError("sparse accessors are not read")
        view, width = self.document.bufferViews[entry.bufferView], {name: n for n, name in _TYPES.items()}[entry.type]
        kind = np.dtype(_COMPONENTS[entry.componentType])
        data = self.binary[view.byteOffset : view.byteOffset + view.byteLength]
        strides = (view.byteStride or width * kind.itemsize, kind.itemsize)
        shape = (room_for(self.remarks.path, entry.count), width)
        values = np.ndarray(shape, kind, data, entry.byteOffset, strides).astype(np.float64)
        return values / np.iinfo(kind).max if entry.normalized else values


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
