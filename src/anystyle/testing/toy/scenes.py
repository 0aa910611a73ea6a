"""Walls: scenes whose pixels, depth and cameras are closed forms."""

from collections.abc import Sequence

import torch

from anystyle.contracts import SceneSource
from anystyle.types import Cameras, Views

DISTANCE = 2.0


class ToyScenes(SceneSource):
    """Flat walls with a coloured wave on them, seen by a camera that moves sideways.

    Args:
        num_scenes: How many walls.
        views: Views a wall.
        size: Height and width in pixels.
        step: How far the camera moves from view to view.
    """

    def __init__(
        self, *, num_scenes: int = 8, views: int = 4, size: tuple[int, int] = (48, 64), step: float = 0.1
    ) -> None:
        if min(num_scenes, views, *size) < 1:
            raise ValueError(f"num_scenes={num_scenes}, views={views}, size={size}: give at least 1 of each")
        self.num_scenes = num_scenes
        self.views = views
        self.size = size
        self.step = step

    def __len__(self) -> int:
        """See :meth:`anystyle.contracts.SceneSource.__len__`."""
        return self.num_scenes

    def name(self, scene: int) -> str:
        """See :meth:`anystyle.contracts.SceneSource.name`."""
        return f"wall_{scene:04d}"

    def num_views(self, scene: int) -> int:
        """See :meth:`anystyle.contracts.SceneSource.num_views`."""
        return self.views

    def read(self, scene: int, views: Sequence[int]) -> Views:
        """See :meth:`anystyle.contracts.SceneSource.read`."""
        height, width = self.size
        focal = float(max(self.size))
        shift = torch.tensor([view * self.step for view in views])  # V
        x = (torch.arange(width) + 0.5 - width / 2) / focal * DISTANCE + shift[:, None]  # V W, on the wall
        y = (torch.arange(height) + 0.5 - height / 2) / focal * DISTANCE  # H
        frequency = 1 + torch.rand(3, 1, 1, generator=torch.Generator().manual_seed(scene)) * 4
        phase = x[:, None, None, :] + y[:, None]  # V 1 H W
        poses = torch.eye(4).repeat(len(views), 1, 1)
        poses[:, 0, 3] = shift
        intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        return Views(
            images=(0.5 + 0.5 * torch.sin(frequency * phase))[None],
            cameras=Cameras(poses[None], intrinsics.repeat(1, len(views), 1, 1), self.size),
            depth=torch.full((1, len(views), height, width), DISTANCE),
            names=tuple(f"{view:03d}" for view in views),
        )
