"""Frames as photographs are: one pinhole image, or one for each eye."""

from dataclasses import replace

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.types import Cameras
from anystyle_film.projection import Layout, Projection
from anystyle_film.scene import FilmedScene

EYES = 1 / 30
"""The distance between the eyes, in distances to the scene: the rule of stereo photography."""


class Pinhole(Projection):
    """Ordinary frames, with the field of view of the camera."""

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        return pinhole_size(cameras, scale, height)

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        return camera.resized(size)

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        return images[0]


class Stereo(Projection):
    """Two ordinary frames side by side, the left eye's on the left; the screen is at the scene's distance.

    Args:
        baseline: Between the eyes in scene units; ``None`` is a thirtieth of the distance to what the cameras see.
    """

    layout = Layout(stereo=True)

    def __init__(self, baseline: float | None = None) -> None:
        self.baseline = baseline

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        height, width = pinhole_size(cameras, scale, height)
        return height, 2 * width

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        baseline = EYES * scene.distance if self.baseline is None else self.baseline
        pair = eyes(camera.resized((size[0], size[1] // 2)), baseline)
        shift = pair.intrinsics[0, :, 0, 0] * pair.intrinsics.new_tensor([-0.5, 0.5]) * baseline / scene.distance
        intrinsics = pair.intrinsics.clone()
        intrinsics[0, :, 0, 2] += shift
        return replace(pair, intrinsics=intrinsics)

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        return torch.cat([images[0], images[1]], dim=-1)


def pinhole_size(cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
    """Even sides, in the aspect of the cameras' images."""
    scale = scale if height is None else height / cameras.size[0]
    high, wide = (max(2, round(side * scale / 2) * 2) for side in cameras.size)
    return high, wide


def eyes(camera: Cameras, baseline: float) -> Cameras:
    """The cameras of the left and the right eye, side by side and parallel."""
    pair = camera.world_from_camera.repeat(1, 2, 1, 1)
    pair[0, :, :3, 3] += pair[0, :, :3, 0] * pair.new_tensor([[-0.5], [0.5]]) * baseline
    return Cameras(pair, camera.intrinsics.repeat(1, 2, 1, 1), camera.size)
