"""What is filmed, and what paths need to know of it."""

from dataclasses import dataclass
from functools import cached_property

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras, Gaussians

OPAQUE = 0.1
"""Gaussians of a lower opacity do not count as surface."""
UPRIGHT, AHEAD = 0.02, 0.02
"""Weights of what is assumed where cameras leave it open: up is that of their images, and the focus is ahead."""


@dataclass(frozen=True)
class FilmedScene:
    """A scene, and the cameras it was made from; all lengths are in its own unit.

    Args:
        gaussians: A batch of one scene.
        cameras: At least one.
    """

    gaussians: Gaussians
    cameras: Cameras

    @property
    def poses(self) -> Float[Tensor, "V 4 4"]:
        """World from camera, in double precision on the CPU."""
        return self.cameras.world_from_camera[0].detach().double().cpu()

    @cached_property
    def up(self) -> Float[Tensor, "3"]:
        """The direction that is up: at right angles to the horizontal axes of all images, as hands hold cameras."""
        right, mean = self.poses[:, :3, 0], F.normalize(-self.poses[:, :3, 1].mean(0), dim=0)
        matrix = right.T @ right / len(right) + UPRIGHT * (torch.eye(3).to(mean) - torch.outer(mean, mean))
        up = torch.linalg.eigh(matrix).eigenvectors[:, 0]
        return up * (1.0 if up @ mean > 0 else -1.0)

    @cached_property
    def distance(self) -> float:
        """From a camera to what it sees, the median over cameras; 1 where they see nothing."""
        means = self.gaussians.means[0, self.gaussians.opacities[0] > OPAQUE].double().cpu()
        height, width = self.cameras.size
        depths = []
        for pose, intrinsics in zip(self.poses, self.cameras.intrinsics[0].double().cpu(), strict=True):
            local = (means - pose[:3, 3]) @ pose[:3, :3]
            local = local[local[:, 2] > 0]
            x, y, z = (local @ intrinsics.T).unbind(1)
            depth = z[(x > 0) & (x < width * z) & (y > 0) & (y < height * z)]
            depths += [depth.median()] if len(depth) else []
        return float(torch.stack(depths).median()) if depths else 1.0

    @cached_property
    def focus(self) -> Float[Tensor, "3"]:
        """The point nearest to all optical axes; where these are parallel, that ahead of their mean at the distance."""
        eyes, forward = self.poses[:, :3, 3], self.poses[:, :3, 2]
        across = torch.eye(3).to(eyes) - forward[:, :, None] * forward[:, None, :]  # projects to an axis's plane
        ahead = (eyes + self.distance * forward).mean(0)
        matrix = across.mean(0) + AHEAD * torch.eye(3).to(eyes)
        return torch.linalg.solve(matrix, (across @ eyes[..., None])[..., 0].mean(0) + AHEAD * ahead)

    def filmed_from(self, poses: Float[Tensor, "V 4 4"], intrinsics: Float[Tensor, "V 3 3"] | None = None) -> Cameras:
        """Cameras of a path; with the mean intrinsics of the scene's cameras unless others are given."""
        like = self.cameras.intrinsics
        if intrinsics is None:
            intrinsics = like[0].mean(0).expand(len(poses), 3, 3)
        return Cameras(poses.to(like)[None], intrinsics.to(like)[None], self.cameras.size)
