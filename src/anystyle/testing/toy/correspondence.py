"""Projection: the correspondence of frames whose depth and cameras are known."""

import torch

from anystyle.contracts import Correspondence
from anystyle.types import Flow, Frames


class ToyCorrespondence(Correspondence):
    """Where each pixel's point projects to in the target; visible wherever that is inside; occlusion is ignored.

    Args:
        margin: Pixels at the target's border that count as outside.
    """

    def __init__(self, *, margin: float = 0.0) -> None:
        self.margin = margin

    def __call__(self, source: Frames, target: Frames) -> Flow:
        if (
            source.depth is None
            or source.intrinsics is None
            or source.world_from_camera is None
            or target.intrinsics is None
            or target.world_from_camera is None
        ):
            raise ValueError("frames without depth or cameras; give depth and poses, or choose another correspondence")
        height, width = source.images.shape[-2:]
        y, x = torch.meshgrid(torch.arange(height) + 0.5, torch.arange(width) + 0.5, indexing="ij")
        pixels = torch.stack([x, y, torch.ones_like(x)]).flatten(1).to(source.depth)  # 3 HW
        points = source.intrinsics.inverse() @ pixels * source.depth.flatten(1)[:, None]  # M 3 HW
        motion = target.world_from_camera.inverse() @ source.world_from_camera
        moved = motion[:, :3, :3] @ points + motion[:, :3, 3:]
        seen = target.intrinsics @ moved
        pixel = seen[:, :2] / seen[:, 2:].clamp_min(1e-6)  # M 2 HW
        limit = torch.tensor([[width], [height]]).to(pixel)
        inside = ((pixel >= self.margin) & (pixel <= limit - self.margin)).all(1)
        visible = inside & (seen[:, 2] > 0) & (source.depth.flatten(1) > 0)
        return Flow((pixel - pixels[:2]).unflatten(2, (height, width)), visible.unflatten(1, (height, width)))
