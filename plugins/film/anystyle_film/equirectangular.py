"""Equirectangular frames: all around, or the half in front for each eye.

A frame is resampled from the faces of a cube. They are wider than a quarter turn, and what two of them see is blended:
renderers project each Gaussian by an approximation in its own image, so that faces differ a little where they meet.
"""

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import ClassVar, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.geometry.cameras import look_at
from anystyle.types import Cameras
from anystyle_film.pinhole import EYES, eyes
from anystyle_film.projection import Layout, Projection
from anystyle_film.scene import FilmedScene

OVERLAP = 5.0
"""Degrees that a face reaches beyond a quarter turn, on each side."""
LARGEST = 1920
"""Pixels; the height of a frame where only a scale is given is no larger."""
FRONT, RIGHT, LEFT, UP, DOWN, BACK = (
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
)
"""Rotations, camera from face; OpenCV's axes."""
_BAND = 1 << 19
"""Pixels whose directions are computed at once."""


class Equirectangular(Projection):
    """All around, 360 by 180 degrees, the camera's direction in the middle and the horizon level."""

    layout = Layout(degrees=360)
    faces: ClassVar = (FRONT, RIGHT, LEFT, UP, DOWN, BACK)

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        return (rows := panorama_height(cameras, scale, height)), 2 * rows

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        return cube(leveled(scene, camera), self.faces, size[0])

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        return resampled(images, resampling(self.faces, size, self.layout.degrees), size)


class Vr180(Projection):
    """The half in front, 180 by 180 degrees, for each eye, side by side, the horizon level.

    Args:
        baseline: Between the eyes in scene units; ``None`` is a thirtieth of the distance to what the cameras see.
    """

    layout = Layout(degrees=180, stereo=True)
    faces: ClassVar = (FRONT, RIGHT, LEFT, UP, DOWN)

    def __init__(self, baseline: float | None = None) -> None:
        self.baseline = baseline

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        return (rows := panorama_height(cameras, scale, height)), 2 * rows

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        baseline = EYES * scene.distance if self.baseline is None else self.baseline
        pair = eyes(leveled(scene, camera), baseline)
        return Cameras.cat([cube(pair.select([eye]), self.faces, size[0]) for eye in (0, 1)], dim=1)

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        half = size[0], size[1] // 2
        taps = resampling(self.faces, half, self.layout.degrees)
        count = len(self.faces)
        return torch.cat([resampled(part, taps, half) for part in (images[:count], images[count:])], dim=-1)


def panorama_height(cameras: Cameras, scale: float, height: int | None) -> int:
    """Rows of a panorama; at scale 1 it has as many pixels a degree as the cameras in the middle of their images."""
    focal = float(cameras.intrinsics[0, :, 1, 1].mean())
    rows = min(LARGEST, round(math.pi * focal * scale)) if height is None else height
    return max(2, round(rows / 2) * 2)


def leveled(scene: FilmedScene, camera: Cameras) -> Cameras:
    """A camera turned so that its y axis is vertical; its heading stays."""
    pose, up = camera.world_from_camera[0, 0].double().cpu(), scene.up
    forward, over = pose[:3, 2], -pose[:3, 1]
    # A camera that looks straight down heads where the upper edge of its image is.
    heading = forward if abs(float(forward @ up)) < 0.999 else over * (-1.0 if float(forward @ up) > 0 else 1.0)
    level = look_at(pose[:3, 3], pose[:3, 3] + heading - (heading @ up) * up, up)
    return Cameras(level.to(camera.world_from_camera)[None, None], camera.intrinsics, camera.size)


def cube(camera: Cameras, faces: tuple, height: int) -> Cameras:
    """The faces around a camera, with the resolution that an equirectangular frame of a height has at its equator."""
    half = math.tan(math.radians(45 + OVERLAP))
    side = math.ceil(height / math.pi * half) * 2
    like = camera.intrinsics
    focal, middle = side / 2 / half, side / 2
    intrinsics = like.new_tensor([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    poses = camera.world_from_camera[0].repeat(len(faces), 1, 1)
    poses[:, :3, :3] = poses[:, :3, :3] @ poses.new_tensor(faces)
    return Cameras(poses[None], intrinsics.expand(1, len(faces), 3, 3), (side, side))


class Taps(NamedTuple):
    """What a frame takes from one face.

    Args:
        pixels: Of the frame, in rows; each once.
        points: Where in the face, as ``grid_sample`` counts.
        weights: Those of all faces are 1 in sum at each pixel.
    """

    pixels: Int[Tensor, " P"]
    points: Float[Tensor, "P 2"]
    weights: Float[Tensor, " P"]


@lru_cache(maxsize=2)
def resampling(faces: tuple, size: tuple[int, int], degrees: int) -> tuple[Taps, ...]:
    """For each face what a frame takes from it."""
    bands = list(_bands(faces, size, degrees))
    return tuple(Taps(*(torch.cat(parts) for parts in zip(*face, strict=True))) for face in zip(*bands, strict=True))


def _bands(faces: tuple, size: tuple[int, int], degrees: int) -> Iterator[list[Taps]]:
    """The taps of all faces for some rows of the frame, band by band: directions of all pixels are many gigabytes."""
    height, width = size
    half, rows = math.tan(math.radians(45 + OVERLAP)), max(1, _BAND // width)
    across = ((torch.arange(width) + 0.5) / width - 0.5) * math.radians(degrees)
    for start in range(0, height, rows):
        down = ((torch.arange(start, min(start + rows, height)) + 0.5) / height - 0.5) * math.pi
        flat, level = down.cos()[:, None], down.sin()[:, None].expand(-1, width)
        directions = torch.stack([flat * across.sin(), level, flat * across.cos()], dim=-1).flatten(0, 1)
        taps = []
        for face in faces:
            x, y, z = (directions @ directions.new_tensor(face)).unbind(1)
            reach = torch.maximum(x.abs(), y.abs()) / z.clamp_min(1e-6)
            margin = 45 + OVERLAP - torch.rad2deg(torch.atan(reach))
            weight = torch.where(z > 0, (margin / (2 * OVERLAP)).clamp(0, 1), 0)
            weight = weight * weight * (3 - 2 * weight)
            (index,) = weight.nonzero(as_tuple=True)
            points = torch.stack([x[index], y[index]], dim=1) / z[index, None] / half
            taps.append(Taps(index + start * width, points, weight[index]))
        total = torch.zeros(len(directions))
        for pixels, _, weights in taps:
            total[pixels - start * width] += weights
        yield [tap._replace(weights=tap.weights / total[tap.pixels - start * width]) for tap in taps]


def resampled(images: Float[Tensor, "V 3 h w"], taps: tuple[Taps, ...], size: tuple[int, int]) -> Tensor:
    """A frame ``[3, H, W]`` of the images of all faces."""
    frame = images.new_zeros(3, size[0] * size[1])
    for image, (pixels, points, weights) in zip(images, taps, strict=True):
        samples = F.grid_sample(image[None], points[None, None], padding_mode="border", align_corners=False)
        frame[:, pixels] += samples[0, :, 0] * weights
    return frame.unflatten(1, size)
