"""3DGS PLY files, as SuperSplat, viser and the original viewer read them."""

from math import isqrt, sqrt
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from plyfile import PlyData, PlyElement, PlyParseError
from torch import Tensor

from anystyle.capacity import require
from anystyle.documents import regular
from anystyle.io.atomic import atomic_path
from anystyle.io.packing import smallest_three_to_wxyz

MAX_DEGREE = 3
"""What viewers read; higher coefficients are left out."""

# Logits and logarithms stay finite: opacities of 0 and 1 and scales of 0 do occur.
_OPACITY_MARGIN = 1e-6
_SMALLEST_SCALE = 1e-12


class Splats(NamedTuple):
    """The tensors of one scene, with the meaning that :class:`anystyle.types.Gaussians` gives them."""

    means: Float[Tensor, "N 3"]
    rotations: Float[Tensor, "N 4"]
    scales: Float[Tensor, "N 3"]
    opacities: Float[Tensor, " N"]
    harmonics: Float[Tensor, "N K 3"]


def write(splats: Splats, path: Path, notes: str = "") -> None:
    """Write one scene, whole or not at all; notes, such as licences, become comments, a line each.

    Every property is float32, in the order positions, normals (0), ``f_dc``, ``f_rest`` (colour-major), opacity
    (logit), scales (logarithm), rotation (unit quaternion wxyz). Gaussians of no opacity are left out.
    """
    kept = splats.opacities > 0
    means, rotations, scales, opacities, harmonics = (tensor[kept].detach().float().cpu() for tensor in splats)
    degree = min(_degree(harmonics.shape[1]), MAX_DEGREE)
    harmonics = harmonics[:, : (degree + 1) ** 2]
    columns = torch.cat(
        [
            means,
            torch.zeros_like(means),
            harmonics[:, 0],
            harmonics[:, 1:].mT.flatten(1),
            torch.logit(opacities.clamp(_OPACITY_MARGIN, 1 - _OPACITY_MARGIN))[:, None],
            scales.clamp_min(_SMALLEST_SCALE).log(),
            torch.nn.functional.normalize(rotations, dim=-1),
        ],
        dim=1,
    )
    names = _properties(degree)
    vertices = np.ascontiguousarray(columns.numpy()).view([(name, "f4") for name in names])[:, 0]
    with atomic_path(path) as temporary:
        comments = notes.encode("ascii", "replace").decode().splitlines()
        PlyData([PlyElement.describe(vertices, "vertex")], comments=comments).write(temporary)


def recolor(source: Path, harmonics: Float[Tensor, "N K 3"], path: Path) -> bool:
    """Write the Gaussians of a file with other colours; every other number keeps its bits, in its order.

    Args:
        source: The file that the Gaussians were read from.
        harmonics: Of all of them; properties of higher degrees are left out.
        path: Written whole or not at all.

    Returns:
        Whether that was done: a compressed file has no number for a colour alone.
    """
    data = PlyData.read(source)
    if "chunk" in data:
        return False
    before = data["vertex"].data
    colors = np.concatenate([harmonics[:, 0].cpu(), harmonics[:, 1:].mT.flatten(1).cpu()], axis=1)  # N 3*K
    names = [f"f_dc_{index}" for index in range(3)] + [f"f_rest_{index}" for index in range(colors.shape[1] - 3)]
    kept = [
        (name, before.dtype[name]) for name in before.dtype.names if not name.startswith("f_rest_") or name in names
    ]
    after = np.empty(len(before), dtype=kept)
    for name, _ in kept:
        after[name] = colors[:, names.index(name)] if name in names else before[name]
    elements = [element for element in data.elements if element.name != "vertex"]
    with atomic_path(path) as temporary:
        PlyData([PlyElement.describe(after, "vertex"), *elements], text=data.text).write(temporary)
    return True


def read(path: Path) -> Splats:
    """Read a file of any degree of harmonics, as trainers write it, or compressed, as SuperSplat does.

    Raises:
        ValueError: It is no PLY file, a damaged one, or not one of Gaussians.
    """
    regular(path, most=None, what="PLY file of Gaussians")
    require(3 * path.stat().st_size, str(path), "a scene of fewer Gaussians, or another machine")
    try:
        data = PlyData.read(path)
        vertices = data["vertex"].data
        columns = unpack(data) if "chunk" in data else {}
    except (PlyParseError, KeyError, ValueError) as error:
        raise ValueError(f"{path} is no PLY file of Gaussians ({error})") from None
    columns = columns or {name: vertices[name] for name in vertices.dtype.names or ()}
    present = columns.keys()
    rest = sum(name.startswith("f_rest_") for name in present)
    if rest % 3:
        raise ValueError(f"{path} has {rest} properties f_rest_*; a multiple of three is expected")
    names = [name for name in _properties(_degree(rest // 3 + 1)) if name not in ("nx", "ny", "nz")]
    missing = [name for name in names if name not in present]
    if missing:
        raise ValueError(f"{path} is a PLY file without the properties {', '.join(missing[:5])} of Gaussians")
    values = torch.from_numpy(np.stack([columns[name].astype(np.float32) for name in names], axis=1))
    if not bool(values.isfinite().all()):
        raise ValueError(f"{path} has properties that are infinite or no numbers; export it again")
    means, constant, higher, opacity, scales, rotations = values.split([3, 3, rest, 1, 3, 4], dim=1)
    return Splats(
        means=means,
        rotations=rotations,
        scales=scales.exp(),
        opacities=opacity[:, 0].sigmoid(),
        harmonics=torch.cat([constant[:, None], higher.unflatten(1, (3, rest // 3)).mT], dim=1),
    )


def _degree(coefficients: int) -> int:
    degree = isqrt(coefficients) - 1
    if (degree + 1) ** 2 != coefficients:
        raise ValueError(
            f"{coefficients} spherical-harmonics coefficients a colour; expected a square, such as 1, 4, 9, 16 or 25"
        )
    return degree


def _properties(degree: int) -> list[str]:
    higher = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{index}" for index in range(higher)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]


CHUNK = 256
"""Gaussians that one row of bounds is for."""

_CONSTANT = 0.5 / sqrt(np.pi)
_BYTE_BOUNDS = 8.0


def unpack(data: PlyData) -> dict[str, Float[np.ndarray, " N"]]:
    """The properties of an ordinary PLY file of Gaussians, by name.

    Raises:
        ValueError: Chunks are missing.
        KeyError: Elements or properties are missing.
    """
    vertex, chunk = data["vertex"].data, data["chunk"].data
    if len(chunk) * CHUNK < len(vertex):
        raise ValueError(f"{len(chunk)} chunks for {len(vertex)} Gaussians; {CHUNK} a chunk are expected")
    rows = np.arange(len(vertex)) // CHUNK

    def between(values: NDArray[np.float64], name: str) -> NDArray[np.float64]:
        low, high = (chunk[f"{bound}_{name}"][rows].astype(np.float64) for bound in ("min", "max"))
        return low + (high - low) * values

    columns: dict[str, NDArray[np.float64]] = {}
    for name, axis, values in zip("xyz", ("x", "y", "z"), _bits_11_10_11(vertex["packed_position"]), strict=True):
        columns[name] = between(values, axis)
    for index, values in enumerate(_bits_11_10_11(vertex["packed_scale"])):
        columns[f"scale_{index}"] = between(values, f"scale_{'xyz'[index]}")
    quaternions = smallest_three_to_wxyz(vertex["packed_rotation"])
    columns |= {f"rot_{index}": quaternions[:, index] for index in range(4)}
    packed = vertex["packed_color"]
    red, green, blue, alpha = ((packed >> shift & 255) / 255 for shift in (24, 16, 8, 0))
    for index, (channel, values) in enumerate(zip("rgb", (red, green, blue), strict=True)):
        bounded = between(values, channel) if f"min_{channel}" in (chunk.dtype.names or ()) else values
        columns[f"f_dc_{index}"] = (bounded - 0.5) / _CONSTANT
    opacity = alpha.clip(1e-6, 1 - 1e-6)
    columns["opacity"] = np.log(opacity / (1 - opacity))
    if "sh" in data:
        for name in data["sh"].data.dtype.names or ():
            columns[name] = _coefficient(data["sh"].data[name])
    return {name: values.astype(np.float32) for name, values in columns.items()}


def _bits_11_10_11(packed: NDArray[np.uint32]) -> tuple[NDArray[np.float64], ...]:
    return (packed >> 21) / 2047, (packed >> 11 & 1023) / 1023, (packed & 2047) / 2047


def _coefficient(packed: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Harmonics of degrees above 0 in [-4, 4]; the first and last byte are the bounds, others middles of intervals."""
    middle = (packed.astype(np.float64) + 0.5) / 256
    unit = np.where(packed == 0, 0.0, np.where(packed == 255, 1.0, middle))
    return (unit - 0.5) * _BYTE_BOUNDS
