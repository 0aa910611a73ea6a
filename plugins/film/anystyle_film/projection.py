"""What a frame shows: a pinhole image or a panorama, for one eye or side by side for two.

A panorama is resampled from the faces of a cube. They are wider than a quarter turn, and what two of them see is
blended: renderers project each Gaussian by an approximation in its own image, so that faces differ where they meet.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.geometry.cameras import look_at
from anystyle.types import Cameras
from anystyle_film.paths import FilmedScene

OVERLAP = 5.0
"""Degrees that a face reaches beyond a quarter turn, on each side."""
HALF = math.tan(math.radians(45 + OVERLAP))
LARGEST = 1920
"""The largest height in pixels of a panorama where only a scale is given."""
EYES = 1 / 30
"""The distance between the eyes, in distances to the scene: the rule of stereo photography."""
FACES = (
    ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    ((-1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0)),
)
"""Rotations, camera from face in OpenCV's axes: front, right, left, up, down and back."""
_BAND = 1 << 19
"""Pixels whose directions are computed at once; those of all pixels are many gigabytes."""


@dataclass(frozen=True)
class Projection:
    """How a frame is made of images that pinhole cameras see.

    Panoramas are equirectangular, the camera's direction in the middle and the horizon level. The screen of a pair of
    ordinary pictures is at the scene's distance.

    Args:
        degrees: That a panorama spans from left to right for each eye, 180 or 360; 0 is an ordinary picture.
        stereo: Whether the left half is for the left eye and the right half for the right one.
        baseline: Between the eyes in scene units; ``None`` is a thirtieth of the distance to what the cameras see.
    """

    degrees: int = 0
    stereo: bool = False
    baseline: float | None = None

    def size(self, cameras: Cameras, scale: float, height: int | None) -> tuple[int, int]:
        """Even height and width of a frame in pixels: ``height``, or ``scale`` times that of the cameras' images.

        At scale 1, a panorama has as many pixels per degree as the middle of these images.
        """
        if self.degrees:
            focal = float(cameras.intrinsics[0, :, 1, 1].mean())
            rows = min(LARGEST, round(math.pi * focal * scale)) if height is None else height
            rows = max(2, round(rows / 2) * 2)
            return rows, 2 * rows
        scale = scale if height is None else height / cameras.size[0]
        high, wide = (max(2, round(side * scale / 2) * 2) for side in cameras.size)
        return high, wide * (1 + self.stereo)

    def views(self, scene: FilmedScene, camera: Cameras, size: tuple[int, int]) -> Cameras:
        """The pinhole cameras whose images a frame of this size is made of; ``camera`` is one of the path."""
        camera = leveled(scene, camera) if self.degrees else camera.resized((size[0], size[1] // (1 + self.stereo)))
        if self.stereo:
            baseline = EYES * scene.distance if self.baseline is None else self.baseline
            sides = camera.intrinsics.new_tensor([-0.5, 0.5]) * baseline
            poses, intrinsics = camera.world_from_camera.repeat(1, 2, 1, 1), camera.intrinsics.repeat(1, 2, 1, 1)
            poses[0, :, :3, 3] += poses[0, :, :3, 0] * sides[:, None]
            intrinsics[0, :, 0, 2] += intrinsics[0, :, 0, 0] * sides / scene.distance
            camera = Cameras(poses, intrinsics, camera.size)
        return cube(camera, self.degrees, size[0]) if self.degrees else camera

    def frame(self, images: Float[Tensor, "V 3 h w"], size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
        """A frame, of the images of all :meth:`views` in their order."""
        halves = images.chunk(1 + self.stereo)
        if self.degrees:
            halves = [panorama(faces, self.degrees, (size[0], size[1] // len(halves))) for faces in halves]
            return torch.cat(halves, dim=-1)
        return torch.cat(images.unbind(), dim=-1)


def leveled(scene: FilmedScene, camera: Cameras) -> Cameras:
    """A camera turned so that its y axis is vertical; its heading stays."""
    pose, up = camera.world_from_camera[0, 0].double().cpu(), scene.up
    forward, over = pose[:3, 2], -pose[:3, 1]
    # A camera that looks straight down heads where the upper edge of its image is.
    heading = forward if abs(float(forward @ up)) < 0.999 else over * (-1.0 if float(forward @ up) > 0 else 1.0)
    level = look_at(pose[:3, 3], pose[:3, 3] + heading - (heading @ up) * up, up)
    return Cameras(level.to(camera.world_from_camera)[None, None], camera.intrinsics, camera.size)


def _faces(degrees: int) -> tuple:
    return FACES if degrees == 360 else FACES[:-1]


def cube(cameras: Cameras, degrees: int, height: int) -> Cameras:
    """The faces around each camera, with the resolution that a panorama of this height has at its equator."""
    faces = cameras.intrinsics.new_tensor(_faces(degrees))
    side = math.ceil(height / math.pi * HALF) * 2
    focal, middle = side / 2 / HALF, side / 2
    intrinsics = faces.new_tensor([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    poses = cameras.world_from_camera[0].repeat_interleave(len(faces), dim=0)
    poses[:, :3, :3] = (cameras.world_from_camera[0, :, None, :3, :3] @ faces).flatten(0, 1)
    return Cameras(poses[None], intrinsics.expand(1, len(poses), 3, 3), (side, side))


class Taps(NamedTuple):
    """Which pixels of a panorama, counted in rows, are taken from where in a face; weights of all faces add up to 1."""

    face: int
    pixels: Int[Tensor, " P"]
    points: Float[Tensor, "P 2"]
    weights: Float[Tensor, " P"]


@lru_cache(maxsize=2)
def resampling(degrees: int, size: tuple[int, int]) -> tuple[Taps, ...]:
    """What a panorama takes from the faces, band by band of its rows."""
    height, width = size
    rows, taps = max(1, _BAND // width), list[Taps]()
    across = ((torch.arange(width) + 0.5) / width - 0.5) * math.radians(degrees)
    for start in range(0, height, rows):
        down = ((torch.arange(start, min(start + rows, height)) + 0.5) / height - 0.5) * math.pi
        flat, level = down.cos()[:, None], down.sin()[:, None].expand(-1, width)
        directions = torch.stack([flat * across.sin(), level, flat * across.cos()], dim=-1).flatten(0, 1)
        band, total = list[Taps](), torch.zeros(len(directions))
        for index, face in enumerate(_faces(degrees)):
            x, y, z = (directions @ directions.new_tensor(face)).unbind(1)
            reach = torch.maximum(x.abs(), y.abs()) / z.clamp_min(1e-6)
            margin = 45 + OVERLAP - torch.rad2deg(torch.atan(reach))
            weight = torch.where(z > 0, (margin / (2 * OVERLAP)).clamp(0, 1), 0)
            weight = weight * weight * (3 - 2 * weight)
            (seen,) = weight.nonzero(as_tuple=True)
            band.append(Taps(index, seen, torch.stack([x[seen], y[seen]], dim=1) / z[seen, None] / HALF, weight[seen]))
            total += weight
        taps += [
            tap._replace(pixels=tap.pixels + start * width, weights=tap.weights / total[tap.pixels]) for tap in band
        ]
    return tuple(taps)


def panorama(images: Float[Tensor, "F 3 h w"], degrees: int, size: tuple[int, int]) -> Float[Tensor, "3 H W"]:
    """An equirectangular image, of those of all faces."""
    frame = images.new_zeros(3, size[0] * size[1])
    for face, pixels, points, weights in resampling(degrees, size):
        samples = F.grid_sample(images[face, None], points[None, None], padding_mode="border", align_corners=False)
        frame[:, pixels] += samples[0, :, 0] * weights
    return frame.unflatten(1, size)
