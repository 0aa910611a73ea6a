"""The reference renderer in plain PyTorch, for every device and floating-point precision."""

from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import normalize
from torch.utils.checkpoint import checkpoint

from anystyle.geometry.harmonics import colors
from anystyle.geometry.projection import MIN_ALPHA, ProjectedGaussians, covariances, project
from anystyle.renderers.rasterizer import CappedRasterizer, at_least_single
from anystyle.types import Cameras, Gaussians

MIN_TRANSMITTANCE = 1e-4
"""Blending of a pixel stops before the Gaussian that would bring its transmittance to this or below."""

TILE = 16
"""Side in pixels of the tiles that are blended at once; results do not depend on it."""


class TorchRenderer(CappedRasterizer):
    """Tile by tile in PyTorch: slow, readable, differentiable in everything."""

    devices = ()
    priority = 1

    def accumulate(self, gaussians: Gaussians, cameras: Cameras) -> Float[Tensor, "B V 5 H W"]:
        scenes, views = cameras.world_from_camera.shape[:2]
        with torch.autocast(gaussians.means.device.type, enabled=False):
            gaussians, cameras = at_least_single(gaussians, cameras)
            each = ((b, v) for b in range(scenes) for v in range(views))
            images = [self.blend_view(*self.project_view(gaussians, cameras, *one), cameras.size) for one in each]
            return torch.stack(images).unflatten(0, (scenes, views))

    def project_view(
        self, gaussians: Gaussians, cameras: Cameras, scene: int, view: int
    ) -> tuple[ProjectedGaussians, Float[Tensor, "n 4"]]:
        """The Gaussians that one view shows, nearest first, and their red, green, blue and depth."""
        means, opacities = gaussians.means[scene], gaussians.opacities[scene]  # N 3, N
        shapes = covariances(gaussians.rotations[scene], gaussians.scales[scene])
        pose, intrinsics = cameras.camera_from_world[scene, view], cameras.intrinsics[scene, view]
        limits: Any = {"near": self.near, "far": self.far, "eps2d": self.eps2d, "antialiased": gaussians.antialiased}
        splats = project(means, shapes, opacities, pose, intrinsics, cameras.size, **limits)
        rays = normalize(means[splats.index] - cameras.world_from_camera[scene, view, :3, 3], dim=-1)  # n 3
        color = colors(gaussians.harmonics[scene, splats.index], rays)  # n 3
        return splats, torch.cat([color, splats.depths[:, None]], dim=-1)

    def blend_view(
        self, splats: ProjectedGaussians, payload: Float[Tensor, "n 4"], size: tuple[int, int]
    ) -> Float[Tensor, "5 H W"]:
        """The payload of one view, accumulated over black, and its transmittance; of a size, height and width."""
        height, width = size
        rows = []
        for top in range(0, height, TILE):
            tiles = []
            for left in range(0, width, TILE):
                y = torch.arange(top, min(top + TILE, height), device=payload.device, dtype=payload.dtype) + 0.5
                x = torch.arange(left, min(left + TILE, width), device=payload.device, dtype=payload.dtype) + 0.5
                near_x = (splats.means[:, 0] - x.mean()).abs() <= splats.radii[:, 0] + len(x) / 2
                near_y = (splats.means[:, 1] - y.mean()).abs() <= splats.radii[:, 1] + len(y) / 2
                index = (near_x & near_y).nonzero().squeeze(1)  # t, nearest first
                here = [splats.means[index], splats.conics[index], splats.opacities[index], payload[index], x, y]
                # Recomputed when gradients are taken, as the alphas of all tiles together would not fit.
                tiles.append(checkpoint(blend, *here, self.alpha_cap, use_reentrant=False, preserve_rng_state=False))
            rows.append(torch.cat(tiles, dim=2))
        return torch.cat(rows, dim=1)


def blend(
    means: Float[Tensor, "t 2"],
    conics: Float[Tensor, "t 3"],
    opacities: Float[Tensor, " t"],
    payload: Float[Tensor, "t 4"],
    x: Float[Tensor, " w"],
    y: Float[Tensor, " h"],
    alpha_cap: float,
) -> Float[Tensor, "5 h w"]:
    """Blend Gaussians, nearest first, in a rectangle of pixels.

    Args:
        means: Image positions in pixels.
        conics: Inverse covariances ``xx, xy, yy``.
        opacities: In [0, 1].
        payload: Red, green, blue and depth of each.
        x: Centres of the columns.
        y: Centres of the rows.
        alpha_cap: The largest alpha of one Gaussian in a pixel.

    Returns:
        The payload, accumulated over black, and the transmittance.
    """
    dx = (x - means[:, 0, None])[:, None, :]  # t 1 w
    dy = (y - means[:, 1, None])[:, :, None]  # t h 1
    xx, xy, yy = conics[:, :, None, None].unbind(1)  # t 1 1
    sigma = 0.5 * (xx * dx * dx + yy * dy * dy) + xy * dx * dy  # t h w
    alpha = (opacities[:, None, None] * (-sigma).exp()).clamp_max(alpha_cap)
    alpha = torch.where((sigma >= 0) & (alpha >= MIN_ALPHA), alpha, 0)
    after = (1 - alpha).cumprod(dim=0)  # transmittance behind each Gaussian
    alpha = torch.where(after > MIN_TRANSMITTANCE, alpha, 0)
    before = torch.cat([torch.ones_like(after[:1]), after[:-1]])
    return torch.cat([torch.einsum("thw,tc->chw", alpha * before, payload), (1 - alpha).prod(dim=0)[None]])
