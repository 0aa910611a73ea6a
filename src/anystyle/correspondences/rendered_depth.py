"""Rendered depth: exact correspondences from the scene's own depth and cameras."""

import torch

from anystyle.contracts import Correspondence
from anystyle.geometry.warp import depth_around, reproject
from anystyle.types import Flow, Frames


class RenderedDepth(Correspondence):
    """Where each pixel's point projects to in the target; no network, no weights, no texture needed.

    A point is visible where it lies inside of the target and nothing there is nearer.

    Args:
        tolerance: How much farther than the target's own depth a point may be, relative, and still be seen.
    """

    def __init__(self, *, tolerance: float = 0.02) -> None:
        if tolerance < 0:
            raise ValueError(f"rendered_depth.tolerance is {tolerance}; it must not be negative")
        self.tolerance = tolerance

    @torch.no_grad()
    def __call__(self, source: Frames, target: Frames) -> Flow:
        known = (source.depth, source.intrinsics, source.world_from_camera)
        there = (target.depth, target.intrinsics, target.world_from_camera)
        (depth, intrinsics, pose), (other_depth, other_intrinsics, other_pose) = known, there
        if (
            depth is None
            or intrinsics is None
            or pose is None
            or other_depth is None
            or other_intrinsics is None
            or other_pose is None
        ):
            raise ValueError(
                "rendered_depth got frames without depth or cameras; give both, or choose correspondence=raft"
            )
        motion = torch.linalg.solve(other_pose, pose)
        moved = reproject(depth, intrinsics, other_intrinsics, motion)
        _, farthest = depth_around(other_depth, moved.displacement)
        seen = moved.inside & (moved.depth <= farthest * (1 + self.tolerance))
        return Flow(torch.where(moved.inside[:, None], moved.displacement, 0), seen)
