"""3DGS PLY files, as SuperSplat, viser and the original viewer read them."""

import io
import re
from collections.abc import Mapping, Sequence
from math import isqrt, sqrt
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement
from torch import Tensor

from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parsing, regular
from anystyle.io.limits import require
from anystyle.io.splats import Offset, Remarks, Splats, near, visible

CHUNK = 256
"""Gaussians that share a row of bounds in a compressed file."""
_CONSTANT = 0.5 / sqrt(np.pi)
"""The constant spherical harmonic."""
_RGB = ("red", "green", "blue")
_SCALAR = "scalar_"
"""What CloudCompare puts before the names of all properties but positions, normals and colours."""
_HEADER = 1 << 16
"""Bytes that are searched for the end of a header."""
ANTIALIASED = "SplatRenderMode: mip"
"""The comment on Gaussians of a training with antialiasing, as gsplat, Brush and splat-transform write it."""
_ASCII = bytes(value if value < 128 else ord("?") for value in range(256))


class OwnCamera(NamedTuple):
    """The camera of the photograph that SHARP made a scene of: a pose, intrinsics in pixels, height and width."""

    camera_from_world: Float[Tensor, "4 4"]
    intrinsics: Float[Tensor, "3 3"]
    size: tuple[int, int]


class Loaded(NamedTuple):
    """The Gaussians of a file without those that show nothing, its rows that they are, and what is taken off it."""

    splats: Splats
    kept: Bool[Tensor, " N"]
    offset: Offset
    camera: OwnCamera | None = None


def write(splats: Splats, path: Path, notes: Sequence[str] = ()) -> None:
    """Write one scene with ``notes``, such as licences, as comments.

    Every property is float32, in the order positions, normals (0), ``f_dc``, ``f_rest`` (colour-major), opacity
    (logit), scales (logarithm), rotation (unit quaternion wxyz). Gaussians of no opacity are left out.
    """
    kept = splats.opacities > 0
    means, rotations, scales, opacities, harmonics = (tensor[kept].detach().float().cpu() for tensor in splats)
    root = isqrt(count := harmonics.shape[1])
    if root**2 != count:
        raise UserError(f"{count} spherical-harmonics coefficients a colour; expected a square, such as 4, 9 or 16")
    # Opacities of 0 and 1 and scales of 0 occur; the margins keep their logits and logarithms finite.
    logits = torch.logit(opacities.clamp(1e-6, 1 - 1e-6))[:, None]
    sizes, quaternions = scales.clamp_min(1e-12).log(), torch.nn.functional.normalize(rotations, dim=-1)
    columns = torch.cat([means, torch.zeros_like(means), _flat(harmonics), logits, sizes, quaternions], dim=1)
    vertices = np.ascontiguousarray(columns.numpy()).view([(name, "f4") for name in _properties(root - 1)])[:, 0]
    with atomic_path(path) as temporary:
        PlyData([PlyElement.describe(vertices, "vertex")], comments=_ascii(notes)).write(temporary)


def recolor(source: Path, harmonics: Float[Tensor, "N K 3"], path: Path, notes: Sequence[str] | None = None) -> bool:
    """Copy the Gaussians of a file with other colours, without properties of higher degrees; False if compressed.

    All other properties keep their bits, but for positions from which :func:`load` takes an offset off. Comments are
    ``notes``, or those of the source.
    """
    data = _parsed(source)
    if "chunk" in data:
        return False
    remarks, before = Remarks(source), data["vertex"].data
    if len(before) == len(harmonics):
        _, offset = near(np.stack([before[axis] for axis in "xyz"], axis=1), remarks)
    else:
        _, shown, offset, _ = _decoded(data, remarks, activated=False)
        before = before[shown.numpy()]
    colors = _flat(harmonics.cpu()).numpy()
    names = [f"f_dc_{index}" for index in range(3)] + [f"f_rest_{index}" for index in range(colors.shape[1] - 3)]
    given = {name: before.dtype[name] for name in before.dtype.names or ()}
    kept = {name: kind for name, kind in given.items() if name in names or not name.startswith(("f_rest_", *_RGB))}
    kinds = kept | {name: given.get(name, np.dtype(np.float32)) for name in names}
    after = np.empty(len(before), dtype=list(kinds.items()))
    for name in kinds:
        after[name] = colors[:, names.index(name)] if name in names else before[name]
    for axis, moved in zip("xyz", offset, strict=True):
        if moved:
            after[axis] -= moved
    with atomic_path(path) as temporary:
        _with_vertices(data, after, data.comments if notes is None else _ascii(notes)).write(temporary)
    return True


def _with_vertices(data: PlyData, rows: NDArray[Any], comments: Sequence[str]) -> PlyData:
    others = [element for element in data.elements if element.name != "vertex"]
    return PlyData([PlyElement.describe(rows, "vertex"), *others], text=data.text, comments=comments)


def _ascii(notes: Sequence[str]) -> list[str]:
    return "\n".join(notes).encode("ascii", "replace").decode().splitlines()


def _flat(harmonics: Float[Tensor, "N K 3"]) -> Float[Tensor, "N 3*K"]:
    """Coefficients as properties: the constant ones, then the others colour by colour."""
    return torch.cat([harmonics[:, 0], harmonics[:, 1:].mT.flatten(1)], dim=1)


def read(path: Path) -> Splats:
    """Read a file of any degree of harmonics, as trainers write it, or compressed, as SuperSplat does."""
    return load(path).splats


def load(path: Path, *, activated: bool = False) -> Loaded:
    """Read a file, also with two scales (2DGS) or the colours ``red green blue``; tell what is left out or guessed.

    An ``activated`` one holds lengths and opacities in [0, 1] in place of logarithms and logits.
    """
    remarks = Remarks(path)
    loaded = _decoded(_parsed(path), remarks, activated=activated)
    remarks.tell()
    return loaded


def comments(path: Path) -> list[str]:
    """The comments of a header, in UTF-8 or else Latin-1."""
    return [_text(line) for line in re.findall(rb"^comment +(.*\S)", _header(path).replace(b"\r", b"\n"), re.MULTILINE)]


def is_antialiased(comment: str) -> bool:
    """Whether a comment says that the training was with antialiasing."""
    return comment.lower() == ANTIALIASED.lower()


def _header(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(_HEADER).partition(b"end_header")[0]


def _text(line: bytes) -> str:
    try:
        return line.decode()
    except UnicodeDecodeError:
        return line.decode("latin-1")


class _AsciiHeader(io.BufferedReader):
    """A binary file whose header is ASCII, as plyfile expects: other bytes, of comments, are question marks."""

    def __init__(self, path: Path, end: int) -> None:
        super().__init__(io.FileIO(path))
        self._end = end

    def read(self, size: int | None = -1) -> bytes:
        start, data = self.tell(), super().read(size)
        return data.translate(_ASCII) if start < self._end else data


def _parsed(path: Path) -> PlyData:
    regular(path, most=None, what="PLY file of Gaussians")
    require(3 * path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    header = _header(path)
    text = re.search(rb"^format +ascii", header, re.MULTILINE)
    with parsing(path, "PLY file of Gaussians"):
        with path.open(encoding="ascii", errors="ignore") if text else _AsciiHeader(path, len(header)) as stream:
            data = PlyData.read(stream)
        if "vertex" not in data:
            raise ValueError("it has no vertices")
        rows = data["vertex"].data
        if any(name.startswith(_SCALAR) for name in rows.dtype.names or ()):
            rows.dtype.names = tuple(name.removeprefix(_SCALAR) for name in rows.dtype.names)
            data = _with_vertices(data, rows, data.comments)
    return data


def _decoded(data: PlyData, remarks: Remarks, *, activated: bool) -> Loaded:
    path, vertices = remarks.path, data["vertex"].data
    with parsing(path, "PLY file of Gaussians"):
        columns = unpack(data) if "chunk" in data else {name: vertices[name] for name in vertices.dtype.names or ()}
    columns = _with_constant(columns, remarks)
    each, odd = divmod(sum(name.startswith("f_rest_") for name in columns), 3)
    if odd:
        raise UserError(f"{path} has {3 * each + odd} properties f_rest_*; a multiple of three is expected")
    degree = isqrt(each + 1) - 1
    higher = (degree + 1) ** 2 - 1
    if higher < each:
        remarks.guesses.append(
            f"of {each} coefficients a colour in f_rest_*, the first {higher} are read, degree {degree}"
        )
    rest = [f"f_rest_{color * each + index}" for color in range(3) for index in range(higher)]
    names = [name for name in _properties(0) if name not in ("x", "y", "z", "nx", "ny", "nz")]
    names[3:3] = rest
    if {"scale_0", "scale_1"} <= columns.keys() and "scale_2" not in columns:
        names.remove("scale_2")
        remarks.guesses.append("without scale_2, its Gaussians are flat discs, as 2DGS writes them")
    if missing := [name for name in ("x", "y", "z", *names) if name not in columns]:
        raise UserError(f"{path} is a PLY file without the properties {', '.join(missing[:5])} of Gaussians")
    means, offset = near(np.stack([columns[axis] for axis in "xyz"], axis=1), remarks)
    with np.errstate(over="ignore"):
        values = torch.from_numpy(np.stack([columns[name].astype(np.float32) for name in names], axis=1))
    constant, others, opacity, scales, rotations = values.split([3, len(rest), 1, len(names) - 8 - len(rest), 4], dim=1)
    harmonics = torch.cat([constant[:, None], others.unflatten(1, (3, higher)).mT], dim=1)
    # Copies, so that the table of all numbers does not stay in memory.
    rows = Splats(torch.from_numpy(means), rotations.clone(), scales.clone(), opacity[:, 0].clone(), harmonics)
    splats, kept = visible(rows, remarks, logarithmic=True, activated=activated)
    if "filter_3D" in columns:
        remarks.guesses.append("filter_3D, as Mip-Splatting writes it, is applied to scales and opacities")
        splats = _filtered(splats, torch.from_numpy(columns["filter_3D"].astype(np.float32))[kept])
    return Loaded(splats, kept, offset, _own_camera(data))


def _own_camera(data: PlyData) -> OwnCamera | None:
    """That of the elements which SHARP writes behind the vertices; ``None`` where they are not there, or damaged."""
    names = ("extrinsic", "intrinsic", "image_size")
    if not all(name in data and len(data[name].properties) == 1 for name in names):
        return None
    pose, matrix, size = (np.asarray(data[name].data[data[name].properties[0].name], np.float32) for name in names)
    if (len(pose), len(matrix), len(size)) != (16, 9, 2) or not (np.isfinite(pose).all() and (size >= 1).all()):
        return None
    width, height = (int(side) for side in size)
    return OwnCamera(torch.from_numpy(pose).view(4, 4), torch.from_numpy(matrix).view(3, 3), (height, width))


def _filtered(splats: Splats, width: Float[Tensor, " N"]) -> Splats:
    """Gaussians widened by Mip-Splatting's 3D filter of a width, and fainter by as much (Yu et al. 2024, eq. 9)."""
    before = splats.scales.double()
    after = torch.hypot(before, width.double().nan_to_num(0.0, 0.0, 0.0)[:, None])
    share = (before / after.clamp_min(1e-38)).prod(1)
    return splats._replace(scales=after.float(), opacities=(splats.opacities * share).float())


def _with_constant(columns: Mapping[str, NDArray[Any]], remarks: Remarks) -> dict[str, NDArray[Any]]:
    """The columns, with ``f_dc_*`` of ``red green blue`` where they have only these."""
    names = [f"f_dc_{index}" for index in range(3)]
    if any(name in columns for name in names) or not all(name in columns for name in _RGB):
        return dict(columns)
    colors = [columns[name] for name in _RGB]
    kind, largest = np.result_type(*colors), max(np.nanmax(color, initial=0) for color in colors)
    known = np.issubdtype(kind, np.integer) and (kind.itemsize == 1 or largest > 255)
    top = float(np.iinfo(kind).max) if known else 255.0 if largest > 1 else 1.0
    if not known:
        remarks.guesses.append(f"red, green and blue are read as numbers from 0 to {top:g}")
    constants = ((color.astype(np.float64) / top - 0.5) / _CONSTANT for color in colors)
    return {**columns, **dict(zip(names, constants, strict=True))}


def _properties(degree: int) -> list[str]:
    return [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{index}" for index in range(3 * ((degree + 1) ** 2 - 1))),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


def unpack(data: PlyData) -> dict[str, NDArray[Any]]:
    """The properties of a compressed file by their names in an uncompressed one."""
    vertex, chunk = data["vertex"].data, data["chunk"].data
    if len(chunk) * CHUNK < len(vertex):
        raise ValueError(f"{len(chunk)} chunks for {len(vertex)} Gaussians; {CHUNK} a chunk are expected")
    rows = np.arange(len(vertex)) // CHUNK

    def between(values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        low, high = (chunk[f"{bound}_{name}"][rows].astype(np.float64) for bound in ("min", "max"))
        return low + (high - low) * values

    columns: dict[str, NDArray[Any]] = {}
    for index, axis in enumerate("xyz"):
        shift, top = ((21, 2047), (11, 1023), (0, 2047))[index]  # 11, 10 and 11 bits
        columns[axis] = between((vertex["packed_position"] >> shift & top) / top, axis)
        columns[f"scale_{index}"] = between((vertex["packed_scale"] >> shift & top) / top, f"scale_{axis}")
    # 2 + 3 x 10 bits: the index of the largest of wxyz, then the others as fractions of ±1/√2.
    packed = vertex["packed_rotation"].astype(np.uint32)
    fractions = np.stack([packed >> shift & 1023 for shift in (20, 10, 0)], 1) / 1023
    quaternions = from_smallest_three((packed >> 30).astype(np.int64), (fractions - 0.5) * sqrt(2))
    columns |= {f"rot_{index}": quaternions[:, index] for index in range(4)}
    *colors, alpha = ((vertex["packed_color"] >> shift & 255) / 255 for shift in (24, 16, 8, 0))
    for index, (channel, values) in enumerate(zip("rgb", colors, strict=True)):
        bounded = between(values, channel) if f"min_{channel}" in (chunk.dtype.names or ()) else values
        columns[f"f_dc_{index}"] = (bounded - 0.5) / _CONSTANT
    opacity = alpha.clip(1e-6, 1 - 1e-6)
    columns["opacity"] = np.log(opacity / (1 - opacity))
    if "sh" in data:
        # Harmonics of higher degrees in [-4, 4]: 0 and 255 are the bounds, other bytes the centres of intervals.
        for name in data["sh"].data.dtype.names or ():
            packed = data["sh"].data[name]
            middle = (packed.astype(np.float64) + 0.5) / 256
            columns[name] = 8 * (np.select([packed == 0, packed == 255], [0.0, 1.0], middle) - 0.5)
    return columns


def from_smallest_three(largest: NDArray[np.int64], others: NDArray[np.float64]) -> Float[np.ndarray, "N 4"]:
    """The inverse of :func:`smallest_three`."""
    quaternions = np.empty((len(largest), 4))
    kept = np.arange(4) != largest[:, None]
    quaternions[kept] = others.ravel()
    quaternions[~kept] = np.sqrt((1 - np.square(others).sum(1)).clip(0))
    return quaternions
