"""A film of a scene as MP4: frames along a path, in a projection, one at a time."""

import logging
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Format, Renderer
from anystyle.errors import UserError, did_you_mean
from anystyle.geometry.confidence import ViewConfidence
from anystyle.io.atomic import atomic_path
from anystyle.io.sheet import to_pil
from anystyle.io.video import write_video
from anystyle.pipeline.load import default_device
from anystyle.ranges import Positive, Range
from anystyle.registry.build import build
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle_film.metadata import mark_video, save_still
from anystyle_film.paths import CameraPath, FilmedScene, orbit, smooth, spiral
from anystyle_film.projection import Projection

log = logging.getLogger(__name__)

FRAMES, MAX_FRAMES = 72, 100_000
PATHS = ("smooth", "orbit", "spiral")
PROJECTIONS = {
    "pinhole": Projection(),
    "stereo": Projection(stereo=True),
    "equirectangular": Projection(degrees=360),
    "vr180": Projection(degrees=180, stereo=True),
}


class Mp4(Format):
    """A film along a path: as a photograph, in stereo, or all around; and stills of it.

    Args:
        renderer: Renders the frames; ``None`` takes the fastest one that runs here.
        kind: ``pinhole``, ``stereo`` (side by side), ``equirectangular`` (360 degrees) or ``vr180`` (180 degrees in
            stereo).
        path: ``smooth`` (through the cameras), ``orbit`` or ``spiral``; or a JSON file of keyframes.
        frames: How many frames; ``None`` is 72, or what a file of keyframes lasts.
        fps: Frames per second.
        scale: Size of a frame relative to the input views.
        height: Height of a frame in pixels, instead of the scale; 1920 is 4K in panoramas.
        stills: How many frames are also written as JPEG into the folder ``stills``, evenly spaced.
        turns: Whole circles of ``orbit`` (default 1) and ``spiral`` (default 2); less than 1 is a part of a circle, and
            below 0 is the other way.
        baseline: Between the eyes in scene units; ``None`` is a thirtieth of the distance to what the cameras see.
        fade: Whether what no photograph shows from about there fades to the background, instead of smearing; ``None``
            is all but panoramas, of which little would be left.
    """

    needs_cameras = True

    def __init__(
        self,
        *,
        renderer: Renderer | None = None,
        kind: Literal["pinhole", "stereo", "equirectangular", "vr180"] = "pinhole",
        path: str = "smooth",
        frames: Annotated[int, Range(ge=1, le=MAX_FRAMES)] | None = None,
        fps: Annotated[int, Range(ge=1, le=1000)] = 24,
        scale: Annotated[float, Range(ge=0.01, le=8)] = 1.0,
        height: Annotated[int, Range(ge=2, le=4320)] | None = None,
        stills: Annotated[int, Range(ge=0, le=1000)] = 0,
        turns: Annotated[float, Range(ge=-100, le=100)] | None = None,
        baseline: Positive | None = None,
        fade: bool | None = None,
    ) -> None:
        self.renderer, self.fps, self.scale, self.height, self.stills = renderer, fps, scale, height, stills
        self.projection = replace(PROJECTIONS[kind], baseline=baseline)
        if baseline is not None and not self.projection.stereo:
            raise UserError(f"video.baseline={baseline:g} has no meaning with video.kind={kind}; leave it out")
        self.fade = not self.projection.degrees if fade is None else fade
        self.path, seconds = _path(path, turns)
        duration = None if seconds is None else max(2, round(seconds * fps) + 1)
        if duration is not None and duration > MAX_FRAMES:
            raise UserError(f"{path}: {duration} frames at video.fps={fps}; a film has at most {MAX_FRAMES}")
        self.frames = frames or duration or FRAMES

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"frames": 2}

    def write(self, scene: StyledScene, path: Path) -> None:
        if not scene.names:
            raise UserError(f"{path}: a film needs the cameras of the scene, and there are none in it or beside it")
        gaussians = scene.styles[-1][1].to(default_device())
        filmed = FilmedScene(gaussians, scene.cameras.to(default_device()), scene.photographed)
        size = self.projection.size(filmed.cameras, self.scale, self.height)
        count = min(self.stills, self.frames)
        kept = {int((index + 0.5) * self.frames / count) for index in range(count)}

        def frames() -> Iterator[Float[Tensor, "3 H W"]]:
            for index, frame in enumerate(self._frames(filmed, size)):
                if index in kept:
                    still = path.parent / "stills" / f"frame_{index:05d}.jpg"
                    save_still(to_pil(frame), still, self.projection)
                yield frame

        with atomic_path(path) as temporary:
            write_video(frames(), temporary, fps=self.fps)
            mark_video(temporary, self.projection)

    @torch.no_grad()
    def _frames(self, scene: FilmedScene, size: tuple[int, int]) -> Iterator[Float[Tensor, "3 H W"]]:
        renderer, path = self.renderer or build(Renderer, "auto"), self.path(scene, self.frames)
        confidence = ViewConfidence.of(scene.gaussians, scene.cameras) if self.fade and scene.photographed else None
        one: Gaussians = scene.gaussians.map(lambda tensor: tensor[:, :1])
        nothing = replace(one, opacities=torch.zeros_like(one.opacities))
        background = renderer(nothing, path.select([0]).resized((1, 1))).color[0, 0]
        shares = list[float]()

        def image(view: Cameras) -> Float[Tensor, "3 H W"]:
            shown = renderer(scene.gaussians, view).color[0, 0]
            if confidence is not None:
                known = confidence(view)
                shares.append(float(known.mean()))
                shown = torch.lerp(background, shown, known)
            return shown.cpu()

        for index in range(path.intrinsics.shape[1]):
            views = self.projection.views(scene, path.select([index]), size)
            each = (views.select([view]) for view in range(views.intrinsics.shape[1]))
            yield self.projection.frame(torch.stack([image(view) for view in each]), size)
        if faded := sum(share < 0.5 for share in shares):
            log.warning(
                "%d of %d views of the film are mostly faded: no photograph was taken from about there; "
                "video.path=smooth stays among the photographs, video.fade=false fades nothing",
                faded,
                len(shares),
            )


def _path(path: str, turns: float | None) -> tuple[CameraPath, float | None]:
    """A path, and how many seconds it takes where it says so."""
    if path in ("orbit", "spiral"):
        turns = turns if turns is not None else 1.0 if path == "orbit" else 2.0
        if turns == 0:
            raise UserError("video.turns=0; give turns of at most 100 either way, and not 0")
        return partial(orbit if path == "orbit" else spiral, turns=turns), None
    if path != "smooth" and Path(path).suffix.lower() != ".json":
        near = did_you_mean(path, PATHS)
        raise UserError(f"video.path={path}; give {', '.join(PATHS)} or a .json file of keyframes.{near}")
    if turns is not None:
        raise UserError(f"video.turns={turns:g} has no meaning with video.path={path}; leave it out")
    if path == "smooth":
        return smooth, None
    from anystyle_film.keyframes import Keyframes

    keyframes = Keyframes(path)
    return keyframes, keyframes.seconds
