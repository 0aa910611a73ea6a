"""Rendered depth: exact correspondences from the scene's own depth and cameras."""

import torch
from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.errors import UserError
from anystyle.geometry.warp import depth_around, reproject
from anystyle.ranges import NonNegative
from anystyle.types import Flow, Frames


class RenderedDepth(Correspondence):
    """Where each pixel's point projects to in the target; no network, no weights, no texture needed.

    A point is visible where it lies inside of the target and nothing there is nearer.

    Args:
        tolerance: How much farther than the target's own depth a point may be, relative, and still be seen.
    """

    def __init__(self, *, tolerance: NonNegative = 0.02) -> None:
        self.tolerance = tolerance

    @torch.no_grad()
    def __call__(self, source: Frames, target: Frames) -> Flow:
        depth, intrinsics, pose = _known(source)
        other_depth, other_intrinsics, other_pose = _known(target)
        moved = reproject(depth, intrinsics, other_intrinsics, torch.linalg.solve(other_pose, pose))
        _, farthest = depth_around(other_depth, moved.displacement)
        seen = moved.inside & (moved.depth <= farthest * (1 + self.tolerance))
        return Flow(torch.where(moved.inside[:, None], moved.displacement, 0), seen)


def _known(frames: Frames) -> tuple[Tensor, Tensor, Tensor]:
    if frames.depth is None or frames.intrinsics is None or frames.world_from_camera is None:
        raise UserError("rendered_depth got frames without depth or cameras; give both, or choose correspondence=raft")
    return frames.depth, frames.intrinsics, frames.world_from_camera
