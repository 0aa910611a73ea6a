"""Depth agreement: whether the views of a stylized scene show one and the same surface."""

from collections.abc import Mapping
from typing import ClassVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.warp import depth_around, reproject
from anystyle.metrics.base import RowMean
from anystyle.ranges import Positive
from anystyle.types import Comparison


class DepthAgreement(RowMean):
    """The share of pixels whose point, seen from the next view, lies on that view's surface, in [0, 1].

    The depth of every view is moved into the next by their cameras. A pixel agrees where the moved depth is within a
    tolerance of one of the four depths around it; points hidden there are not counted. Rows without
    depth or cameras, or with one view, are left out.

    Args:
        tolerance: Relative tolerance of depths.

    Example:
        >>> frames = torch.full((1, 2, 3, 32, 32), 0.5)
        >>> still = Cameras(torch.eye(4).repeat(1, 2, 1, 1), torch.eye(3).repeat(1, 2, 1, 1), (32, 32))
        >>> depth = torch.ones(1, 2, 32, 32)
        >>> depth[:, 1, :8] = 2  # a quarter of the wall is farther in the second view
        >>> DepthAgreement()(frames, cameras=still, depth=depth)
        {'depth_agreement': tensor(0.7500)}
    """

    better: ClassVar[Mapping[str, str]] = {"depth_agreement": "higher"}
    takes = ("preds", "cameras", "depth")
    lacking: ClassVar[str] = "no two views with depth and cameras (folders give both by --depth)"

    def __init__(self, *, tolerance: Positive = 0.05) -> None:
        super().__init__()
        self.tolerance = tolerance

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The share of each row, over all its pairs; ``nan`` where no pixel counts."""
        depth, cameras = comparison.depth, comparison.cameras
        if depth is None or cameras is None or depth.shape[1] < 2:
            return torch.zeros(0, dtype=torch.float64, device=comparison.stylized.device)
        poses, intrinsics = cameras.world_from_camera, cameras.intrinsics
        shares = []
        for row in range(depth.shape[0]):
            motion = torch.linalg.solve(poses[row, 1:], poses[row, :-1])
            moved = reproject(depth[row, :-1], intrinsics[row, :-1], intrinsics[row, 1:], motion)
            nearest, farthest = depth_around(depth[row, 1:], moved.displacement)
            hidden = moved.depth > farthest * (1 + self.tolerance)
            counted = moved.inside & (nearest > 0) & ~hidden
            agrees = counted & (moved.depth >= nearest * (1 - self.tolerance))
            # NaN where no pixel counts.
            shares.append(agrees.double().sum() / counted.double().sum())
        return torch.stack(shares)
