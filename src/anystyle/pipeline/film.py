"""Films of scenes as MP4: along the cameras, in a circle, or along a path of nerfstudio's viewer."""

import logging
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from threading import Event
from typing import Annotated, NamedTuple

import msgspec
import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation, RotationSpline
from torch import Tensor

from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at, smooth_path
from anystyle.geometry.confidence import ViewConfidence, projected
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import read_json
from anystyle.io.sheet import to_pil
from anystyle.io.video import write_video
from anystyle.pipeline.export import turn
from anystyle.pipeline.options import MAX_FRAMES, VideoOptions
from anystyle.ranges import Positive
from anystyle.types import Cameras, Gaussians, Renders, StyledScene

FRAMES = 72
"""Of a film whose path does not say how long it takes."""
QUALITY = 92
"""Of stills, as JPEG."""
OPAQUE = 0.1
"""Gaussians of a lower opacity do not count as surface."""
SEEN = 0.01
"""A frame that is less opaque than this, on average over its pixels, shows nothing of the scene."""
UPRIGHT, AHEAD = 0.02, 0.02
"""Weights of what is assumed where cameras leave it open: up is that of their images, and the focus is ahead."""

_log = logging.getLogger(__name__)


Render = Callable[[Gaussians, Cameras], Renders]
"""Renders one view of Gaussians, such as a :class:`~anystyle.contracts.Renderer`."""


class Film:
    """Films scenes as options say.

    Args:
        options: The path, and the number and size of frames.

    Raises:
        UserError: The file of the path is missing, or holds none.
    """

    def __init__(self, options: VideoOptions) -> None:
        self.options, seconds, self._told = options, None, set[str]()
        if options.path == "smooth":
            self.path = smooth
        elif options.path == "orbit":
            self.path = partial(orbit, turns=1.0 if options.turns is None else options.turns)
        else:
            flight = read_flight(Path(options.path))
            self.path, seconds = partial(along, flight), float(flight.times[-1])
        self.frames = options.frames or (max(2, round(seconds * options.fps) + 1) if seconds else FRAMES)
        if self.frames > MAX_FRAMES:
            raise UserError(
                f"{options.path}: {self.frames} frames at video.fps={options.fps}; a film has at most {MAX_FRAMES}"
            )

    def write(self, scene: StyledScene, path: Path, render: Render, stop: Event | None = None) -> None:
        """Write the film of a scene in its last style, whole or not at all, and its stills beside it.

        Raises:
            UserError: The scene has no cameras, or another thread has set ``stop``.
        """
        if not scene.names:
            raise UserError("a film needs the cameras of the scene, and there are none in it or beside it")
        gaussians = scene.styles[-1][1]
        seen = scene.cameras.to(gaussians.means.device)
        confidence = ViewConfidence.of(gaussians, seen) if self.options.fade and scene.photographed else None
        count = min(self.options.stills, self.frames)
        kept = {int((index + 0.5) * self.frames / count) for index in range(count)}

        def frames() -> Iterator[Float[Tensor, "3 H W"]]:
            for index, frame in enumerate(self.images(gaussians, seen, confidence, render)):
                if stop is not None and stop.is_set():
                    raise UserError(f"{path} is not needed any more")
                if index in kept:
                    with atomic_path(path.parent / "stills" / f"frame_{index:05d}.jpg") as still:
                        to_pil(frame).save(still, "JPEG", quality=QUALITY, subsampling=0)
                yield frame

        write_video(frames(), path, fps=self.options.fps)

    @torch.no_grad()
    def images(
        self, gaussians: Gaussians, seen: Cameras, confidence: ViewConfidence | None, render: Render
    ) -> Iterator[Float[Tensor, "3 H W"]]:
        """The frames; what ``confidence`` does not know from about there fades to the background."""
        path = self.path(gaussians, seen, self.frames).resized(self.size(seen))
        one = gaussians.map(lambda tensor: tensor[:, :1])
        nothing = replace(one, opacities=torch.zeros_like(one.opacities))
        background = render(nothing, path.select([0]).resized((1, 1))).color[0, 0]
        shares, seen_shares = list[float](), list[float]()
        for index in range(self.frames):
            camera = path.select([index])
            rendered = render(gaussians, camera)
            shown = rendered.color[0, 0]
            seen_shares.append(float(rendered.alpha.mean()))
            if confidence is not None:
                known = confidence(camera)
                shares.append(float(known.mean()))
                shown = torch.lerp(background, shown, known)
            yield shown.cpu()
        found = {
            f"show less than {SEEN:.0%} of the scene": sum(share < SEEN for share in seen_shares),
            "are mostly faded: no photograph was taken from about there; video.path=smooth stays among the "
            "photographs, video.fade=false fades nothing": sum(share < 0.5 for share in shares),
        }
        for what, count in found.items():
            if count and what not in self._told:  # the films of other styles show as much
                self._told.add(what)
                _log.warning("%d of %d views of the film %s", count, self.frames, what)

    def line(self, seen: Cameras) -> str:
        """What the film of a scene with these cameras will be."""
        height, width = self.size(seen)
        return f"of {self.frames} frames of {width} x {height}, {self.options.fps} a second"

    def size(self, seen: Cameras) -> tuple[int, int]:
        """Height and width of a frame in pixels, both even."""
        height, scale = self.options.height, self.options.scale
        scale = scale if height is None else height / seen.size[0]
        rows, columns = (max(2, round(side * scale / 2) * 2) for side in seen.size)
        return rows, columns


def smooth(gaussians: Gaussians, seen: Cameras, frames: int) -> Cameras:
    """A smooth flight through the cameras, from the first to the last."""
    return smooth_path(seen, frames)


def orbit(gaussians: Gaussians, seen: Cameras, frames: int, turns: float = 1.0) -> Cameras:
    """A circle around what the cameras look at, at their mean distance and height; for captures that go around.

    Below 0, ``turns`` are the other way; a part of one has the cameras' mean direction in its middle.
    """
    poses = seen.world_from_camera[0].detach().double().cpu()
    center, up = _focus(poses, _distance(gaussians, seen)), _up(poses)
    offsets = poses[:, :3, 3] - center
    radius = offsets.norm(dim=1).mean().clamp_min(1e-6)
    rise = torch.asin((offsets @ up / offsets.norm(dim=1).clamp_min(1e-6)).clamp(-0.99, 0.99)).mean()
    towards = _level(offsets.mean(0), up)
    aside = torch.linalg.cross(up, towards)
    begin = -math.pi * turns if abs(turns) < 1 else 0.0
    angle = begin + 2 * math.pi * turns * torch.arange(frames).to(up)[:, None] / frames
    eye = center + radius * (rise.cos() * (angle.cos() * towards + angle.sin() * aside) + rise.sin() * up)
    poses = look_at(eye, center.expand_as(eye), up).to(seen.intrinsics)
    return Cameras(poses[None], seen.intrinsics.mean(1, keepdim=True).expand(1, frames, 3, 3), seen.size)


def _up(poses: Float[Tensor, "V 4 4"]) -> Float[Tensor, "3"]:
    """The direction that is up: at right angles to the horizontal axes of all images, as hands hold cameras."""
    right, mean = poses[:, :3, 0], F.normalize(-poses[:, :3, 1].mean(0), dim=0)
    matrix = right.T @ right / len(right) + UPRIGHT * (torch.eye(3).to(mean) - torch.outer(mean, mean))
    up = torch.linalg.eigh(matrix).eigenvectors[:, 0]
    return up * (1.0 if up @ mean > 0 else -1.0)


def _distance(gaussians: Gaussians, seen: Cameras) -> float:
    """From a camera to what it sees, the median over cameras; 1 where they see nothing."""
    means = gaussians.means[0, gaussians.opacities[0] > OPAQUE].double().cpu()
    depths = []
    for view in range(seen.intrinsics.shape[1]):
        (position,), (inside,) = projected(means, seen.select([view]))
        depths += [position[inside, 2].median()] if inside.any() else []
    return float(torch.stack(depths).median()) if depths else 1.0


def _focus(poses: Float[Tensor, "V 4 4"], distance: float) -> Float[Tensor, "3"]:
    """The point nearest to all optical axes; where these are parallel, that ahead of their mean at the distance."""
    eyes, forward = poses[:, :3, 3], poses[:, :3, 2]
    across = torch.eye(3).to(eyes) - forward[:, :, None] * forward[:, None, :]  # projects to an axis's plane
    ahead = (eyes + distance * forward).mean(0)
    matrix = across.mean(0) + AHEAD * torch.eye(3).to(eyes)
    return torch.linalg.solve(matrix, (across @ eyes[..., None])[..., 0].mean(0) + AHEAD * ahead)


def _level(direction: Float[Tensor, "3"], up: Float[Tensor, "3"]) -> Float[Tensor, "3"]:
    """The horizontal part of a direction, or any horizontal direction where it has none."""
    flat = direction - (direction @ up) * up
    if flat.norm() < 1e-6 * direction.norm().clamp_min(1e-6):
        flat = torch.linalg.cross(up, torch.eye(3).to(up)[int(up.abs().argmin())])
    return F.normalize(flat, dim=0)


class Flight(NamedTuple):
    """A camera path: poses in OpenCV's axes, vertical fields of view in degrees, and seconds from 0."""

    world_from_camera: Float[np.ndarray, "V 4 4"]
    fov: Float[np.ndarray, " V"]
    times: Float[np.ndarray, " V"]


class _Keyframe(msgspec.Struct):
    camera_to_world: Annotated[list[float], msgspec.Meta(min_length=16, max_length=16)]
    fov: Annotated[float, msgspec.Meta(gt=0, lt=180)]


class _File(msgspec.Struct):
    camera_path: Annotated[list[_Keyframe], msgspec.Meta(max_length=MAX_FRAMES)]
    camera_type: str = "perspective"
    fps: Positive | None = None
    seconds: Positive | None = None


def read_flight(path: Path) -> Flight:
    """Read ``camera_paths/*.json`` of nerfstudio's viewer, which has interpolated the frames between its keyframes.

    A frame has a pose by rows, with OpenGL's axes of cameras in a world whose z axis is up, and a vertical field of
    view in degrees. Without frames per second and seconds there are 24 frames per second.

    Raises:
        UserError: There is no such file, it has no frames, a pose is no rigid motion, or its cameras are panoramic.
    """
    content: _File = read_json(path, _File, what="camera path of nerfstudio")
    frames = content.camera_path
    if content.camera_type.lower() != "perspective":
        raise UserError(f"{path} is a path of a camera of type {content.camera_type!r}; save one of type perspective")
    if not frames:
        raise UserError(f"{path} has no frames; add keyframes in the viewer, and press Generate Command again")
    poses = torch.tensor([frame.camera_to_world for frame in frames], dtype=torch.float64).unflatten(1, (4, 4))
    turns = poses[:, :3, :3]
    rigid = (turns @ turns.mT - torch.eye(3)).abs().amax() < 1e-3 and bool((turns.det() > 0).all())
    if not rigid or not bool((poses[:, 3] == torch.eye(4)[3]).all()):
        raise UserError(f"{path}: camera_to_world of a frame is not a rotation and translation, by rows")
    poses = turn("z", "opencv", poses).poses(poses * torch.tensor([1.0, -1.0, -1.0, 1.0]).double())
    fps = content.fps or (len(frames) / content.seconds if content.seconds else 24.0)
    return Flight(poses.numpy(), np.array([frame.fov for frame in frames]), np.arange(len(frames)) / fps)


def along(flight: Flight, gaussians: Gaussians, seen: Cameras, frames: int) -> Cameras:
    """A path from a file, evenly spaced in time, with smooth positions, directions and fields of view."""
    poses, views, known = flight
    times, path = np.linspace(0, known[-1], frames), np.tile(np.eye(4), (frames, 1, 1))
    if len(poses) == 1:
        path[:], views = poses[0], np.repeat(views, frames)
    else:
        path[:, :3, 3] = PchipInterpolator(known, poses[:, :3, 3])(times)
        path[:, :3, :3] = RotationSpline(known, Rotation.from_matrix(poses[:, :3, :3]))(times).as_matrix()
        views = PchipInterpolator(known, views)(times)
    height, width = seen.size
    mean = seen.intrinsics[0].double().mean(0).cpu().numpy()
    intrinsics = np.tile(np.eye(3), (frames, 1, 1))
    intrinsics[:, 1, 1] = height / 2 / np.tan(np.radians(views) / 2)
    intrinsics[:, 0, 0] = intrinsics[:, 1, 1] * mean[0, 0] / mean[1, 1]
    intrinsics[:, :2, 2] = width / 2, height / 2
    like = seen.intrinsics
    return Cameras(torch.from_numpy(path).to(like)[None], torch.from_numpy(intrinsics).to(like)[None], seen.size)
