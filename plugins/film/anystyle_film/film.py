"""The film of a result: frames along a path, in a projection, one at a time."""

from collections.abc import Iterator
from pathlib import Path
from typing import TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import RenderFrames, Video
from anystyle.errors import UserError
from anystyle.io.sheet import to_pil
from anystyle.io.video import write_video
from anystyle.registry.build import build, kind_of
from anystyle.registry.catalog import catalog
from anystyle.registry.schema import options
from anystyle.registry.socket import Socket
from anystyle.types import Cameras, Gaussians
from anystyle_film.contract import CameraPath, Projection
from anystyle_film.metadata import mark_video, save_still
from anystyle_film.scene import FilmedScene

FRAMES = 72
MAX_FRAMES, MAX_FPS, MAX_STILLS = 100_000, 1000, 1000
MAX_HEIGHT = 4320
STILLS = "stills"

T = TypeVar("T", bound=Socket)


class Film(Video):
    """A film along a path: as a photograph, in stereo, or all around; and stills of it.

    Args:
        kind: A plugin of kind ``projection``: ``pinhole``, ``stereo`` (side by side), ``equirectangular`` (360 degrees)
            or ``vr180`` (180 degrees in stereo).
        path: A plugin of kind ``camera_path``: ``smooth``, ``orbit`` or ``spiral``; or a JSON file of keyframes.
        frames: How many frames; ``None`` is 72, or what a file of keyframes lasts.
        fps: Frames a second.
        scale: Size of a frame relative to the input views.
        height: Of a frame in pixels, instead of the scale; 1920 is 4K in panoramas.
        stills: How many frames are written as JPEG, too, evenly spaced.
        turns: Of ``orbit`` and ``spiral``; less than 1 is a part of a circle, and below 0 is the other way.
        baseline: Between the eyes in scene units; ``None`` is a thirtieth of the distance to what the cameras see.
    """

    def __init__(
        self,
        *,
        kind: str = "pinhole",
        path: str = "smooth",
        frames: int | None = None,
        fps: int = 24,
        scale: float = 1.0,
        height: int | None = None,
        stills: int = 0,
        turns: float | None = None,
        baseline: float | None = None,
    ) -> None:
        self.fps, self.scale, self.height, self.stills = fps, scale, height, stills
        _between("frames", frames, 1, MAX_FRAMES)
        _between("fps", fps, 1, MAX_FPS)
        _between("scale", scale, 0.01, 8)
        _between("height", height, 2, MAX_HEIGHT)
        _between("stills", stills, 0, MAX_STILLS)
        self.path = _path(path, turns)
        self.projection = _chosen(Projection, "kind", kind, baseline=baseline)
        lasts = None if self.path.seconds is None else max(2, round(self.path.seconds * fps) + 1)
        _between("frames", lasts, 1, MAX_FRAMES)
        self.frames = frames or lasts or FRAMES

    def write(self, gaussians: Gaussians, cameras: Cameras, render: RenderFrames, folder: Path) -> None:
        scene = FilmedScene(gaussians, cameras)
        size = self.projection.size(cameras, self.scale, self.height)
        path = self.path(scene, self.frames)
        count = min(self.stills, self.frames)
        kept = {int((index + 0.5) * self.frames / count) for index in range(count)}

        def frames() -> Iterator[Float[Tensor, "3 H W"]]:
            for index, frame in enumerate(self._frames(scene, path, size, render)):
                if index in kept:
                    still = folder / STILLS / f"frame_{index:05d}.jpg"
                    save_still(to_pil(frame), still, self.projection.layout)
                yield frame

        write_video(frames(), folder / "video.mp4", fps=self.fps)
        mark_video(folder / "video.mp4", self.projection.layout)

    def _frames(
        self, scene: FilmedScene, path: Cameras, size: tuple[int, int], render: RenderFrames
    ) -> Iterator[Float[Tensor, "3 H W"]]:
        for index in range(path.intrinsics.shape[1]):
            views = self.projection.views(scene, path.select([index]), size)
            images = list(render(views))
            if len(images) < views.intrinsics.shape[1]:
                return  # the film is not needed any more
            yield self.projection.frame(torch.stack(images), size)


def _path(path: str, turns: float | None) -> CameraPath:
    """The plugin of a name, or that of a file's suffix."""
    names = catalog().names("camera_path")
    if path in names or not Path(path).suffix:
        return _chosen(CameraPath, "path", path, turns=turns)
    suffix = Path(path).suffix[1:].lower()
    if suffix not in names:
        raise UserError(f"video.path={path}; no plugin of kind camera_path reads .{suffix} files")
    return _chosen(CameraPath, "path", suffix, turns=turns, file=path)


def _chosen(base: type[T], option: str, name: str, **given: object) -> T:
    """A plugin with what was given of its arguments; one that has no use for it is refused."""
    passed = {key: value for key, value in given.items() if value is not None}
    plugin = catalog().find(kind_of(base), name)
    taken = [item.name for item in options(plugin)]
    strange = next((key for key in passed if key not in taken), None)
    if strange is not None:
        raise UserError(f"video.{strange}={passed[strange]} has no meaning with video.{option}={name}; leave it out")
    return build(base, {"_target_": plugin.path, **passed})


def _between(option: str, value: float | None, low: float, high: float) -> None:
    if value is not None and not low <= value <= high:
        raise UserError(f"video.{option}={value}; give a number from {low} to {high}")
