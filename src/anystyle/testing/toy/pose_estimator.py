"""A row of cameras: the smallest estimator of poses."""

from collections.abc import Sequence

import torch

from anystyle.contracts import PosedViews, PoseEstimator, Verdict
from anystyle.data.folder import as_views, common_size, cover
from anystyle.types import Cameras, OnProgress, Original, Progress


class ToyPoseEstimator(PoseEstimator):
    """Cameras side by side that all look ahead, whatever the photographs show.

    Args:
        step: From camera to camera, in scene units.
    """

    def __init__(self, *, step: float = 0.2) -> None:
        self.step = step

    def __call__(
        self, originals: Sequence[Original], *, short_side: int, multiple: int, enlarge: bool, on_progress: OnProgress
    ) -> PosedViews | Verdict:
        number = len(originals)
        on_progress(Progress(f"{number} cameras in a row"))
        sizes = [(original.size[1], original.size[0]) for original in originals]  # width, height
        size = common_size(sizes, short_side=short_side, multiple=multiple, enlarge=enlarge)
        covered = [cover(item.name, item.picture, full, size) for item, full in zip(originals, sizes, strict=True)]
        poses = torch.eye(4).repeat(1, number, 1, 1)
        poses[0, :, 0, 3] = self.step * torch.arange(number)
        focal, (height, width) = float(max(size)), size
        intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        return PosedViews(
            views=as_views(covered, Cameras(poses, intrinsics.repeat(1, number, 1, 1), size)),
            sources=tuple(source for _, source in covered),
            points=(torch.zeros(0, 3),) * number,
            verdict=Verdict("doubtful", ("the cameras are assumed to stand in a row; check them",), {}),
        )
