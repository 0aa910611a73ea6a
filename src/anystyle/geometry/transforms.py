"""Rotations as quaternions and matrices, and similarities: changes of frame with a scale.

Quaternions are ``wxyz`` (3DGS, PLY files, gsplat) unless a name says ``xyzw`` (scipy, VGGT's pose encoding).
"""

from dataclasses import replace
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry import harmonics
from anystyle.types import Gaussians


def wxyz_from_xyzw(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Move the real part to the front."""
    return quaternions.roll(1, dims=-1)


def matrix_from_wxyz(quaternions: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of quaternions of any norm; that of the zero quaternion is the identity.

    Example:
        >>> matrix_from_wxyz(torch.tensor([0.0, 1.0, 0.0, 0.0]))  # half a turn about x
        tensor([[ 1.,  0.,  0.],
                [ 0., -1.,  0.],
                [ 0.,  0., -1.]])
    """
    w, x, y, z = F.normalize(quaternions, dim=-1).unbind(-1)
    i, j, k = 2 * x, 2 * y, 2 * z
    xx, yy, zz, xy, xz, yz, wx, wy, wz = i * x, j * y, k * z, i * y, i * z, j * z, i * w, j * w, k * w
    entries = [1 - (yy + zz), xy - wz, xz + wy, xy + wz, 1 - (xx + zz), yz - wx, xz - wy, yz + wx, 1 - (xx + yy)]
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def wxyz_from_matrix(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 4"]:
    """Unit quaternions of rotation matrices, with ``w`` at least 0.

    The columns of the outer product ``q qᵀ`` are linear in the matrix; the one with the largest diagonal entry is
    normalised, which is accurate for every angle, half turns included.
    """
    m = matrices
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    entries = [
        1 + xx + yy + zz, wx, wy, wz,
        wx, 1 + xx - yy - zz, xy, xz,
        wy, xy, 1 - xx + yy - zz, yz,
        wz, xz, yz, 1 - xx - yy + zz,
    ]  # fmt: skip
    outer = torch.stack(entries, dim=-1).unflatten(-1, (4, 4))  # ... 4 4, four times q qᵀ
    best = outer.diagonal(dim1=-2, dim2=-1).argmax(dim=-1)  # ...
    column = torch.take_along_dim(outer, best[..., None, None], dim=-2).squeeze(-2)  # ... 4
    unit = F.normalize(column, dim=-1)
    return torch.where(unit[..., :1] < 0, -unit, unit)


def multiply(left: Float[Tensor, "*batch 4"], right: Float[Tensor, "*batch 4"]) -> Float[Tensor, "*batch 4"]:
    """Hamilton products: the rotation that turns by ``right`` first and by ``left`` then."""
    (a, u), (b, v) = (each.tensor_split([1], dim=-1) for each in torch.broadcast_tensors(left, right))
    return torch.cat([a * b - (u * v).sum(-1, keepdim=True), a * v + b * u + torch.linalg.cross(u, v)], dim=-1)


def cross_matrix(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The matrices that give cross products: ``cross_matrix(v) @ x`` is ``v`` cross ``x``."""
    x, y, z = vectors.unbind(-1)
    zero = torch.zeros_like(x)
    return torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=-1).unflatten(-1, (3, 3))


def matrix_from_vector(vectors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Rotation matrices of rotation vectors: the axis times the angle in radians."""
    return torch.linalg.matrix_exp(cross_matrix(vectors))


def nearest_rotation(matrices: Float[Tensor, "*batch 3 3"]) -> Float[Tensor, "*batch 3 3"]:
    """The rotation ``R`` with the largest ``trace(Rᵀ M)`` for each matrix (Kabsch 1976; orthogonal Procrustes)."""
    u, _, vh = torch.linalg.svd(matrices)
    sign = torch.ones_like(matrices[..., 0])
    sign[..., 2] = torch.det(u @ vh)
    return u @ (sign[..., None] * vh)


class Similarity(NamedTuple):
    """A change of frame ``x -> scale rotation x + translation``.

    Example:
        >>> double = Similarity(torch.tensor(2.0), torch.eye(3), torch.tensor([1.0, 0.0, 0.0]))
        >>> moved = double.points(torch.tensor([1.0, 1.0, 1.0]))
        >>> moved
        tensor([3., 2., 2.])
        >>> double.inverse().points(moved)
        tensor([1., 1., 1.])
    """

    scale: Float[Tensor, ""]
    rotation: Float[Tensor, "3 3"]
    translation: Float[Tensor, "3"]

    def inverse(self) -> "Similarity":
        """The inverse change of frame."""
        rotation = self.rotation.mT
        return Similarity(1 / self.scale, rotation, -(rotation @ self.translation) / self.scale)

    def after(self, first: "Similarity") -> "Similarity":
        """The composition: ``first``, then this one."""
        return Similarity(
            self.scale * first.scale,
            self.rotation @ first.rotation,
            self.scale * (self.rotation @ first.translation) + self.translation,
        )

    def points(self, points: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """Points of the old frame in the new one."""
        return self.scale * points @ self.rotation.mT + self.translation

    def poses(self, world_from_camera: Float[Tensor, "*batch 4 4"]) -> Float[Tensor, "*batch 4 4"]:
        """Rigid poses of cameras of the old frame in the new one; they stay rigid, the scale moves their origins."""
        pose = world_from_camera.clone()
        pose[..., :3, :3] = self.rotation @ world_from_camera[..., :3, :3]
        pose[..., :3, 3] = self.points(world_from_camera[..., :3, 3])
        return pose

    def gaussians(self, gaussians: Gaussians) -> Gaussians:
        """Gaussians of the old frame in the new one: centres, orientations, sizes and the colours' directions."""
        rotation = wxyz_from_matrix(self.rotation).expand_as(gaussians.rotations)
        color = gaussians.harmonics
        return replace(
            gaussians,
            means=self.points(gaussians.means),
            rotations=multiply(rotation, gaussians.rotations),
            scales=self.scale * gaussians.scales,
            harmonics=harmonics.rotate(color, self.rotation) if color.shape[2] > 1 else color,
        )


def similarity_of_cameras(source: Float[Tensor, "V 4 4"], target: Float[Tensor, "V 4 4"]) -> Similarity:
    """The similarity that brings cameras closest to others of the same views.

    The rotation is the chordal mean of the views' rotations, since the positions of a few cameras on a line leave it
    open; scale and translation then have the least squared error of the positions. Cameras at one position keep their
    scale; positions that do not move alike, with a correlation of at most 0.1, have none: it is 0. ``source`` and
    ``target`` are world from camera in the old and new frame.
    """
    rotation = nearest_rotation((target[:, :3, :3] @ source[:, :3, :3].mT).mean(0))
    rotated, positions = source[:, :3, 3] @ rotation.mT, target[:, :3, 3]
    source_spread, target_spread = rotated - rotated.mean(0), positions - positions.mean(0)
    size, product = source_spread.square().sum(), (source_spread * target_spread).sum()
    alike = product > 0.1 * size.sqrt() * target_spread.norm()
    scale = torch.where(size > 1e-12, torch.where(alike, product / size.clamp_min(1e-12), 0.0), 1.0)
    return Similarity(scale, rotation, positions.mean(0) - scale * rotated.mean(0))
