"""Similarities: changes of frame with a scale, and what they do to cameras and Gaussians."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry import harmonics
from anystyle.geometry.rotations import multiply, nearest_rotation, wxyz_from_matrix
from anystyle.types import Gaussians


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
        return Gaussians(
            means=self.points(gaussians.means),
            rotations=multiply(rotation, gaussians.rotations),
            scales=self.scale * gaussians.scales,
            opacities=gaussians.opacities,
            harmonics=harmonics.rotate(color, self.rotation) if color.shape[2] > 1 else color,
        )


def y_up_from_opencv(like: Float[Tensor, "..."]) -> Similarity:
    """Half a turn about x: from OpenCV's axes (y down, z forward) to those most viewers expect (y up, z backward)."""
    return Similarity(like.new_ones(()), torch.diag(like.new_tensor([1.0, -1.0, -1.0])), like.new_zeros(3))


def similarity_of_cameras(source: Float[Tensor, "V 4 4"], target: Float[Tensor, "V 4 4"]) -> Similarity:
    """The similarity that brings cameras closest to others of the same views.

    The rotation is the chordal mean of the views' rotations, since the positions of a few cameras on a line leave it
    open; scale and translation then have the least squared error of the positions. Cameras at one position keep their
    scale. ``source`` and ``target`` are world from camera in the old and new frame.
    """
    rotation = nearest_rotation((target[:, :3, :3] @ source[:, :3, :3].mT).mean(0))
    rotated, positions = source[:, :3, 3] @ rotation.mT, target[:, :3, 3]
    source_spread, target_spread = rotated - rotated.mean(0), positions - positions.mean(0)
    size = source_spread.square().sum()
    scale = (source_spread * target_spread).sum().clamp_min(0) / size.clamp_min(1e-12)
    scale = torch.where(size > 1e-12, scale, 1.0)
    return Similarity(scale, rotation, positions.mean(0) - scale * rotated.mean(0))
