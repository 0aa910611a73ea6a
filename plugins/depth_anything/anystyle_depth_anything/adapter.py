"""From raw attributes to Gaussians, one a pixel."""

from functools import cache
from math import pi
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.geometry.harmonics import basis
from anystyle.geometry.rotations import multiply, wxyz_from_matrix, wxyz_from_xyzw, xyzw_from_wxyz
from anystyle.types import Attributes, Cameras, Clusters, Gaussians, Geometry


class Adapter(contracts.Adapter):
    """Activates, and moves from each camera's axes into the world; no pixels are fused.

    Args:
        depth_along: ``ray``: depth is read as the distance along the pixel's ray, as the published weights were
            trained; ``z``: as what it is elsewhere, the distance along the camera's axis.
        rotations: ``published``: the quaternion's entries change places on the way into the world, a side effect of
            the published code that its weights were trained with; ``camera``: it is xyzw in the camera's axes.
        scale_min: Least scale, in tenths of the sum of a pixel's sides at the Gaussian's depth.
        scale_max: Largest scale, in the same unit.
    """

    def __init__(
        self,
        *,
        depth_along: Literal["ray", "z"],
        rotations: Literal["published", "camera"],
        scale_min: float,
        scale_max: float,
    ) -> None:
        super().__init__()
        self.depth_along = depth_along
        self.rotations = rotations
        self.scale_min, self.scale_max = scale_min, scale_max

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Each pixel is a Gaussian of its own."""
        return None

    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Activate; a Gaussian moves from its pixel by the attributes' offset, in pixels and in units of depth.

        Raises:
            ValueError: The attributes have no offset.
        """
        if attributes.offset is None:
            raise ValueError("the attributes have no offset of pixel and depth; this adapter needs one")
        with torch.autocast(geometry.depth.device.type, enabled=False):
            attributes = attributes.to(geometry.depth.dtype)
            cameras, offset = geometry.cameras, attributes.to(geometry.depth.dtype).offset
            assert offset is not None
            depth = geometry.depth + offset[..., 2]
            means = self.means(cameras, depth, offset[..., :2])
            turns = wxyz_from_matrix(cameras.world_from_camera[..., :3, :3])[:, :, None, None]
            return Gaussians(
                means=means.flatten(1, 3),
                rotations=self.turned(attributes.rotation, turns).flatten(1, 3),
                scales=self.scales(attributes.scale, cameras, depth).flatten(1, 3),
                opacities=attributes.opacity.sigmoid().flatten(1),
                harmonics=harmonics(attributes.color, cameras).flatten(1, 3),
            )

    def means(
        self, cameras: Cameras, depth: Float[Tensor, "B V H W"], offset: Float[Tensor, "B V H W 2"]
    ) -> Float[Tensor, "B V H W 3"]:
        """Points in the world, of pixels moved by ``offset``."""
        height, width = depth.shape[-2:]
        v, u = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        pixels = torch.stack([u, v], dim=-1).to(depth) + offset
        lens = cameras.intrinsics[:, :, None, None]
        xy = (pixels - lens[..., :2, 2]) / torch.stack([lens[..., 0, 0], lens[..., 1, 1]], dim=-1)
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

    def turned(
        self, rotation: Float[Tensor, "B V H W 4"], turns: Float[Tensor, "B V 1 1 4"]
    ) -> Float[Tensor, "B V H W 4"]:
        """Quaternions wxyz in the world; see ``rotations``."""
        unit = rotation / (rotation.norm(dim=-1, keepdim=True) + 1e-8)
        turns = turns.expand(*unit.shape)
        if self.rotations == "camera":
            return multiply(turns, wxyz_from_xyzw(unit))
        world = multiply(turns, unit.roll(2, dims=-1))
        return xyzw_from_wxyz(torch.where(world[..., :1] < 0, -world, world))


def harmonics(color: Float[Tensor, "B V H W 3 K"], cameras: Cameras) -> Float[Tensor, "B V H W K 3"]:
    """Damped coefficients, turned into the world, coefficient-major."""
    degree = round(color.shape[-1] ** 0.5) - 1
    damped = color * color.new_tensor(damping(degree))
    if degree == 0:  # which looks the same from everywhere
        return damped.mT
    rotation = cameras.world_from_camera[..., :3, :3]
    return torch.einsum("bvkj,bvhwcj->bvhwkc", turning(rotation, degree), damped)


def damping(degree: int) -> list[float]:
    """A factor for each coefficient up to ``degree``: 1, and ``0.1 * 0.25 ** d`` for degree d > 0."""
    return [1.0] + [0.1 * 0.25**d for d in range(1, degree + 1) for _ in range(2 * d + 1)]


def turning(rotations: Float[Tensor, "*batch 3 3"], degree: int) -> Float[Tensor, "*batch K K"]:
    """Matrices that turn coefficients from camera to world: those of one degree turn among themselves.

    They follow from the values of the harmonics at more directions than there are harmonics.
    """
    directions, inverse = (part.to(rotations.device) for part in _probe(degree))
    seen = basis(directions @ rotations.double(), degree)  # ... M K, in the axes of the camera
    degrees = torch.arange((degree + 1) ** 2, device=rotations.device).sqrt().floor()  # degree of each coefficient
    return (inverse @ seen * (degrees[:, None] == degrees)).to(rotations.dtype)


@cache
def _probe(degree: int) -> tuple[Float[Tensor, "M 3"], Float[Tensor, "K M"]]:
    """Unit vectors on a Fibonacci spiral, and what gives coefficients from values there."""
    count = 8 * (degree + 1) ** 2
    index = torch.arange(count, dtype=torch.float64, device="cpu") + 0.5
    z = 1 - 2 * index / count
    angle, radius = index * (pi * (3 - 5**0.5)), (1 - z * z).sqrt()
    directions = torch.stack([radius * angle.cos(), radius * angle.sin(), z], dim=-1)
    return directions, torch.linalg.pinv(basis(directions, degree))
