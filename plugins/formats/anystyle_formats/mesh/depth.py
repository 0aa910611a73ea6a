"""Depth as a scene's cameras see it, and which of it they agree on."""

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.types import Cameras, Gaussians

OPAQUE = 0.9
"""Where less light is absorbed there is no surface."""
TOLERANCE = 0.03
"""Depths of one point from two cameras that differ by a smaller part of them agree."""
NEIGHBORS, WITNESSES = 8, 2
"""Other cameras that are asked for each pixel, and how many of them have to agree; one where there are two cameras."""


@dataclass(frozen=True)
class DepthViews:
    """Rendered views of one scene.

    Args:
        cameras: Of one scene.
        color: In [0, 1].
        depth: Along the optical axis; 0 where there is no surface.
        agreed: Where other cameras see the same point at the same depth.
    """

    cameras: Cameras
    color: Float[Tensor, "V 3 H W"]
    depth: Float[Tensor, "V H W"]
    agreed: Bool[Tensor, "V H W"]

    @property
    def agreement(self) -> float:
        """The part of all surfaces that is agreed on, in [0, 1]."""
        seen = int((self.depth > 0).sum())
        return int(self.agreed.sum()) / seen if seen else 0.0


@torch.no_grad()
def render_depth(gaussians: Gaussians, cameras: Cameras, renderer: Renderer) -> DepthViews:
    """Render all views of a batch of one scene, and compare their depths."""
    colors, depths = [], []
    for view in range(cameras.intrinsics.shape[1]):
        renders = renderer(gaussians, cameras.select([view]))
        alpha = renders.alpha[0, 0].cpu()
        depths.append(torch.where(alpha > OPAQUE, renders.depth[0, 0].cpu() / alpha.clamp_min(OPAQUE), 0))
        colors.append(renders.color[0, 0].cpu())
    depth = torch.stack(depths)
    return DepthViews(cameras.to("cpu"), torch.stack(colors), depth, _agreed(cameras.to("cpu"), depth))


def points_of(cameras: Cameras, view: int, depth: Float[Tensor, "H W"]) -> Float[Tensor, "H W 3"]:
    """The points in world space that the pixels of a view show."""
    pose, matrix = cameras.world_from_camera[0, view], cameras.intrinsics[0, view]
    y, x = torch.meshgrid(*(torch.arange(side) + 0.5 for side in depth.shape), indexing="ij")
    rays = torch.stack([(x - matrix[0, 2]) / matrix[0, 0], (y - matrix[1, 2]) / matrix[1, 1], torch.ones_like(x)], -1)
    return (rays * depth[..., None]) @ pose[:3, :3].T + pose[:3, 3]


def projected(
    cameras: Cameras, view: int, points: Float[Tensor, "N 3"]
) -> tuple[Float[Tensor, "N 2"], Float[Tensor, " N"]]:
    """Where a view shows points, as ``grid_sample`` counts, and their depth; beyond 1 outside and behind the camera."""
    pose, matrix = cameras.world_from_camera[0, view], cameras.intrinsics[0, view]
    x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).unbind(-1)
    safe = z.clamp_min(1e-6)
    height, width = cameras.size
    across = 2 * (matrix[0, 0] * x / safe + matrix[0, 2]) / width - 1
    down = 2 * (matrix[1, 1] * y / safe + matrix[1, 2]) / height - 1
    return torch.where(z[:, None] > 0, torch.stack([across, down], -1), 2.0), z


def sampled(image: Float[Tensor, "C H W"], where: Float[Tensor, "N 2"], mode: str = "nearest") -> Float[Tensor, "C N"]:
    """Values of an image at places; 0 outside."""
    return F.grid_sample(image[None], where[None, None], mode=mode, align_corners=False)[0, :, 0]


def _agreed(cameras: Cameras, depth: Float[Tensor, "V H W"]) -> Bool[Tensor, "V H W"]:
    count = len(depth)
    centers = cameras.world_from_camera[0, :, :3, 3]
    nearest = torch.cdist(centers, centers).argsort(dim=1, stable=True)
    agreed = torch.zeros(depth.shape, dtype=torch.bool)
    for view in range(count):
        points = points_of(cameras, view, depth[view]).flatten(0, 1)
        votes = torch.zeros(len(points), dtype=torch.int)
        for other in [index for index in nearest[view].tolist() if index != view][:NEIGHBORS]:
            where, z = projected(cameras, other, points)
            found = sampled(depth[other][None], where)[0]
            votes += (found > 0) & ((found - z).abs() < TOLERANCE * z)
        enough = votes.view(depth[view].shape) >= min(WITNESSES, count - 1)
        agreed[view] = enough & (depth[view] > 0)
    return agreed
