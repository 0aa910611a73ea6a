"""Texturing a scene from its views: each point takes its colour from one of them."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras


def single_view_colors(
    color: Float[Tensor, "B V H W C"], points: Float[Tensor, "B V H W 3"], cameras: Cameras, tolerance: float = 0.15
) -> Float[Tensor, "B V H W C"]:
    """Repaint points by the first view that sees them, so that views which were painted one by one agree.

    As surfaces are textured from photographs (Lempitsky and Ivanov, CVPR 2007), but with few and large patches: views
    come in the order of their distance from the origin of the scene's frame, where bundled backbones place the view
    that differs least from all others. Colours are interpolated bicubically and differentiable; the choice of views is
    constant. A view sees a point whose distance along z is within the ``tolerance`` of that of the pixel it falls on;
    points that no view sees keep their colours.
    """
    rows = zip(color, points, cameras.world_from_camera, cameras.intrinsics, strict=True)
    return torch.stack([_repainted(*row, tolerance) for row in rows])


def _repainted(
    color: Float[Tensor, "V H W C"],
    points: Float[Tensor, "V H W 3"],
    world_from_camera: Float[Tensor, "V 4 4"],
    intrinsics: Float[Tensor, "V 3 3"],
    tolerance: float,
) -> Float[Tensor, "V H W C"]:
    height, width = color.shape[1:3]
    limit = points.new_tensor([width, height])
    flat, painted = points.detach().flatten(0, 2), color.flatten(0, 2).clone()
    left = torch.arange(len(flat), device=flat.device)
    for view in world_from_camera[:, :3, 3].norm(dim=-1).argsort().tolist():
        rotation, origin = world_from_camera[view, :3, :3], world_from_camera[view, :3, 3]
        depth = (points[view].detach() - origin) @ rotation[:, 2]  # H W
        in_camera = (flat[left] - origin) @ rotation
        z = in_camera[:, 2]
        xy = (in_camera @ intrinsics[view].mT)[:, :2] / z.clamp_min(1e-8)[:, None]
        inside = ((xy >= 0) & (xy < limit)).all(1) & (z > 0)
        column, row = torch.where(inside[:, None], xy, 0).long().unbind(1)
        expected = depth[row, column]
        seen = inside & ((z - expected).abs() <= tolerance * expected)
        grid, picture = (2 * xy[seen] / limit - 1)[None, None], color[view].movedim(-1, 0)[None].to(xy.dtype)
        sampled = F.grid_sample(picture, grid, mode="bicubic", padding_mode="border", align_corners=False)
        painted[left[seen]] = sampled[0, :, 0].mT.to(color.dtype)
        left = left[~seen]
    return painted.view_as(color)
