"""3DGS PLY files, as SuperSplat, viser and the original viewer read them."""

from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement, PlyParseError

from anystyle.files import atomic_path
from anystyle.geometry.harmonics import basis, degree_of
from anystyle.geometry.rotations import multiply
from anystyle.types import Gaussians

MAX_DEGREE = 3
"""What viewers read; higher coefficients are left out."""

# Logits and logarithms stay finite: opacities of 0 and 1 and scales of 0 do occur.
_OPACITY_MARGIN = 1e-6
_SMALLEST_SCALE = 1e-12


def write(gaussians: Gaussians, path: Path, *, scene: int = 0, y_up: bool = False) -> None:
    """Write one scene; whole or not at all.

    Every property is float32, in the order positions, normals (0), ``f_dc``, ``f_rest`` (colour-major), opacity
    (logit), scales (logarithm), rotation (unit quaternion wxyz). Gaussians of no opacity are left out.

    Args:
        gaussians: A batch of scenes.
        path: A ``.ply`` file.
        scene: Which scene of the batch.
        y_up: Turn the scene by half a turn about x, from OpenCV's y-down axes to those most viewers expect.
    """
    kept = gaussians.opacities[scene] > 0
    means, rotations, scales, opacities, harmonics = (
        tensor[scene][kept].detach().float().cpu()
        for tensor in (
            gaussians.means,
            gaussians.rotations,
            gaussians.scales,
            gaussians.opacities,
            gaussians.harmonics,
        )
    )
    degree = min(degree_of(harmonics.shape[1]), MAX_DEGREE)
    harmonics = harmonics[:, : (degree + 1) ** 2]
    if y_up:
        flip = torch.tensor([1.0, -1.0, -1.0])
        half_turn = torch.tensor([0.0, 1.0, 0.0, 0.0])
        means, rotations = means * flip, multiply(half_turn.expand_as(rotations), rotations)
        # A half turn about an axis leaves each real harmonic or changes its sign: read off at any generic direction.
        direction = torch.nn.functional.normalize(torch.tensor([0.3, 0.5, 0.8]), dim=0)
        harmonics = harmonics * (basis(direction * flip, degree) / basis(direction, degree)).round()[:, None]
    rotations = torch.nn.functional.normalize(rotations, dim=-1)
    opacities = opacities.clamp(_OPACITY_MARGIN, 1 - _OPACITY_MARGIN)
    columns = torch.cat(
        [
            means,
            torch.zeros_like(means),
            harmonics[:, 0],
            harmonics[:, 1:].mT.flatten(1),
            torch.logit(opacities)[:, None],
            scales.clamp_min(_SMALLEST_SCALE).log(),
            rotations,
        ],
        dim=1,
    )
    names = _properties(degree)
    vertices = np.ascontiguousarray(columns.numpy()).view([(name, "f4") for name in names])[:, 0]
    with atomic_path(path) as temporary:
        PlyData([PlyElement.describe(vertices, "vertex")]).write(temporary)


def read(path: Path) -> Gaussians:
    """Read a file as a batch of one scene.

    Raises:
        ValueError: It is no PLY file, a damaged one, or not one of Gaussians.
    """
    try:
        vertices = PlyData.read(path)["vertex"].data
    except (PlyParseError, KeyError, ValueError) as error:
        raise ValueError(f"{path} is no PLY file of Gaussians ({error})") from None
    present = vertices.dtype.names or ()
    rest = sum(name.startswith("f_rest_") for name in present)
    if rest % 3:
        raise ValueError(f"{path} has {rest} properties f_rest_*; a multiple of three is expected")
    degree = degree_of(rest // 3 + 1)
    names = [name for name in _properties(degree) if name not in ("nx", "ny", "nz")]
    missing = [name for name in names if name not in present]
    if missing:
        raise ValueError(f"{path} is a PLY file without the properties {', '.join(missing[:5])} of Gaussians")
    columns = torch.from_numpy(np.stack([vertices[name].astype(np.float32) for name in names], axis=1))
    if not bool(columns.isfinite().all()):
        raise ValueError(f"{path} has properties that are infinite or no numbers; export it again")
    means, constant, higher, opacity, scales, rotations = columns.split([3, 3, rest, 1, 3, 4], dim=1)
    harmonics = torch.cat([constant[:, None], higher.unflatten(1, (3, rest // 3)).mT], dim=1)
    return Gaussians(
        means=means[None],
        rotations=rotations[None],
        scales=scales.exp()[None],
        opacities=opacity[None, :, 0].sigmoid(),
        harmonics=harmonics[None],
    )


def _properties(degree: int) -> list[str]:
    higher = 3 * ((degree + 1) ** 2 - 1)
    return [
        *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"),
        *(f"f_rest_{place}" for place in range(higher)),
        *("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"),
    ]
