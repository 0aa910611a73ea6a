"""From raw attributes to Gaussians, one per pixel."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.geometry.harmonics import damping, rotation_matrices
from anystyle.geometry.transforms import multiply, wxyz_from_matrix, wxyz_from_xyzw
from anystyle.geometry.warp import pixels
from anystyle.nn.tokens import constant
from anystyle.types import Attributes, Cameras, Clusters, Gaussians, Geometry


class Adapter(contracts.Adapter):
    """Activates raw attributes and transforms them into the world; no pixels are fused."""

    def __init__(
        self,
        *,
        depth_along: Literal["ray", "z"],
        rotations: Literal["published", "camera"],
        scale_min: float,
        scale_max: float,
    ) -> None:
        super().__init__()
        self.depth_along, self.rotations = depth_along, rotations
        self.scale_min, self.scale_max = scale_min, scale_max

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Each pixel is a Gaussian of its own."""
        return None

    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Activate; a Gaussian moves from its pixel by the attributes' offset, in pixels and in units of depth."""
        with torch.autocast(geometry.depth.device.type, enabled=False):
            attributes = attributes.to(geometry.depth.dtype)
            cameras, offset = geometry.cameras, attributes.offset
            assert offset is not None
            depth = geometry.depth + offset[..., 2]
            camera_rotations = wxyz_from_matrix(cameras.world_from_camera[..., :3, :3])[:, :, None, None]
            return Gaussians(
                means=self.means(cameras, depth, offset[..., :2]).flatten(1, 3),
                rotations=self.rotated(attributes.rotation, camera_rotations).flatten(1, 3),
                scales=self.scales(attributes.scale, cameras, depth).flatten(1, 3),
                opacities=attributes.opacity.sigmoid().flatten(1),
                harmonics=harmonics(attributes.color, cameras).flatten(1, 3),
            )

    def means(
        self, cameras: Cameras, depth: Float[Tensor, "B V H W"], offset: Float[Tensor, "B V H W 2"]
    ) -> Float[Tensor, "B V H W 3"]:
        """Points in the world, of pixels moved by ``offset``."""
        places = pixels(depth).movedim(0, -1) + 0.5 + offset
        intrinsics = cameras.intrinsics[:, :, None, None]
        xy = (places - intrinsics[..., :2, 2]) / intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
        ray = F.pad(xy, (0, 1), value=1.0)
        if self.depth_along == "ray":
            ray = F.normalize(ray, dim=-1)
        pose = cameras.world_from_camera[:, :, None, None]
        return pose[..., :3, 3] + (pose[..., :3, :3] @ (ray * depth[..., None])[..., None])[..., 0]

    def scales(
        self, scale: Float[Tensor, "B V H W 3"], cameras: Cameras, depth: Float[Tensor, "B V H W"]
    ) -> Float[Tensor, "B V H W 3"]:
        """Standard deviations, in proportion to what a pixel covers at the Gaussian's depth.

        Behind the camera the published code has negative ones; their squares are what counts.
        """
        focal = cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]  # B V 2
        unit = 0.1 * (1 / focal).sum(-1)[:, :, None, None] * depth.abs()
        return (self.scale_min + (self.scale_max - self.scale_min) * scale.sigmoid()) * unit[..., None]

    def rotated(
        self, rotation: Float[Tensor, "B V H W 4"], camera_rotations: Float[Tensor, "B V 1 1 4"]
    ) -> Float[Tensor, "B V H W 4"]:
        """Quaternions wxyz in the world; see ``rotations``."""
        unit = rotation / (rotation.norm(dim=-1, keepdim=True) + 1e-8)
        camera_rotations = camera_rotations.expand(*unit.shape)
        if self.rotations == "camera":
            return multiply(camera_rotations, wxyz_from_xyzw(unit))
        world = multiply(camera_rotations, unit.roll(2, dims=-1))
        return torch.where(world[..., :1] < 0, -world, world).roll(-1, dims=-1)  # xyzw


def harmonics(color: Float[Tensor, "B V H W 3 K"], cameras: Cameras) -> Float[Tensor, "B V H W K 3"]:
    """Damped coefficients, rotated into the world, coefficient-major."""
    degree = round(color.shape[-1] ** 0.5) - 1
    damped = color * constant(tuple(damping(degree)), color.device, color.dtype)
    if degree == 0:  # the same from every direction
        return damped.mT
    rotation = cameras.world_from_camera[..., :3, :3]
    return torch.einsum("bvkj,bvhwcj->bvhwkc", rotation_matrices(rotation, degree), damped)
