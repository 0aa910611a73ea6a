"""Walls: scenes whose pixels, depth and cameras are closed forms."""

from collections.abc import Sequence

import torch

from anystyle.contracts import SceneSource
from anystyle.types import Cameras, Views


class ToyScenes(SceneSource):
    """Flat walls at an angle with a coloured wave on them, seen by a camera that moves right, down and ahead.

    Args:
        num_scenes: How many walls.
        views: Views a wall.
        size: Height and width in pixels.
        step: How far the camera moves to the right from view to view.
    """

    def __init__(
        self, *, num_scenes: int = 8, views: int = 4, size: tuple[int, int] = (48, 64), step: float = 0.1
    ) -> None:
        self.num_scenes, self.views, self.size, self.step = num_scenes, views, size, step

    def __len__(self) -> int:
        return self.num_scenes

    def name(self, scene: int) -> str:
        return f"wall_{scene:04d}"

    def num_views(self, scene: int) -> int:
        return self.views

    def read(self, scene: int, views: Sequence[int]) -> Views:
        (height, width), number = self.size, len(views)
        focal = float(max(self.size))
        poses = torch.eye(4).repeat(number, 1, 1)
        poses[:, :3, 3] = self.step * torch.tensor(list(views))[:, None] * torch.tensor([1.0, 0.5, 0.25])
        intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
        u = ((torch.arange(width) + 0.5 - width / 2) / focal).expand(height, width)  # a point at depth 1 on each ray
        v = ((torch.arange(height) + 0.5 - height / 2) / focal)[:, None]
        right, down, ahead = poses[:, :3, 3, None, None].unbind(1)
        depth = (2 + right / 2 - ahead) / (1 - u / 2)  # V H W, to the wall z = 2 + x / 2
        x, y = right + depth * u, down + depth * v
        frequency = 1 + torch.rand(3, 1, 1, generator=torch.Generator().manual_seed(scene)) * 4
        return Views(
            images=(0.5 + 0.5 * torch.sin(frequency * (x + y)[:, None]))[None],
            cameras=Cameras(poses[None], intrinsics.repeat(1, number, 1, 1), self.size),
            depth=depth[None],
            names=tuple(f"{view:03d}" for view in views),
        )
