"""Projection: the correspondence of frames whose depth and cameras are known."""

import math

from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.errors import UserError
from anystyle.geometry.warp import reproject
from anystyle.types import Flow, Frames


class ToyCorrespondence(Correspondence):
    """Where each pixel's point projects to in the target; visible wherever that is inside; occlusion is ignored.

    Args:
        farthest: Depth beyond which nothing counts as visible.
    """

    def __init__(self, *, farthest: float = math.inf) -> None:
        self.farthest = farthest

    def __call__(self, source: Frames, target: Frames) -> Flow:
        (depth, intrinsics, pose), (_, other_intrinsics, other_pose) = _known(source), _known(target)
        moved = reproject(depth, intrinsics, other_intrinsics, other_pose.inverse() @ pose)
        return Flow(moved.displacement, moved.inside & (moved.depth <= self.farthest))


def _known(frames: Frames) -> tuple[Tensor, Tensor, Tensor]:
    if frames.depth is None or frames.intrinsics is None or frames.world_from_camera is None:
        raise UserError("frames without depth or cameras; give depth and poses, or choose another correspondence")
    return frames.depth, frames.intrinsics, frames.world_from_camera
