"""Cameras in or beside the file of a scene: of this program, of trainers' runs, and those of its photographs."""

import logging
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
import torch
from msgspec import Meta

from anystyle.contracts import StoredCamera
from anystyle.data.poses import stored_cameras, view_camera
from anystyle.errors import UserError
from anystyle.geometry.confidence import projected
from anystyle.geometry.transforms import Similarity
from anystyle.io.documents import read_json
from anystyle.io.splats import Offset
from anystyle.paths import distinct, short_names
from anystyle.pipeline.export import turn
from anystyle.ranges import Positive
from anystyle.types import Cameras, SourceImage, StyledScene

_log = logging.getLogger(__name__)
_Row3 = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]
Side = Annotated[int, Meta(gt=0, le=100_000)]
"""Pixels of a picture's height or width."""
MORE = 2
"""Cameras are taken to have the axes of a file where they then see more Gaussians by this factor."""


@dataclass(frozen=True)
class SavedCamera:
    """A view in ``cameras.json``."""

    name: str
    height: Side
    width: Side
    intrinsics: tuple[_Row3, _Row3, _Row3]
    world_from_camera: tuple[_Row4, _Row4, _Row4, _Row4]


@dataclass(frozen=True)
class SavedCameras:
    """``cameras.json``."""

    views: Annotated[list[SavedCamera], Meta(min_length=1)]


@dataclass(frozen=True)
class _ModelFrame:
    """``dataparser_transforms.json`` of a run of nerfstudio: a point of its model is ``scale (R x + t)``."""

    transform: Annotated[list[_Row4], Meta(min_length=3, max_length=3)]
    scale: Positive


def with_stored_cameras(
    scene: StyledScene, path: Path, stored_in: str | None = None, own_up: str = "opencv"
) -> StyledScene:
    """A scene with the cameras beside its file where it has none of its own.

    Arguments are those of :func:`cameras_beside`.
    """
    stored = {} if scene.names else cameras_beside(path, stored_in, scene, own_up)
    names = short_names([PurePosixPath(name) for name in stored])
    return with_cameras(scene, dict(zip(names, stored.values(), strict=True))) if stored else scene


def with_cameras(
    scene: StyledScene, stored: Mapping[str, StoredCamera], size: tuple[int, int] | None = None
) -> StyledScene:
    """A scene with cameras by the names of their views, all of one size, by default the commonest."""
    size, sizes = size or commonest_size(stored.values()), tuple(camera.size for camera in stored.values())
    sources = [SourceImage.covering(name, own, size, whole=True) for name, own in zip(stored, sizes, strict=True)]
    views = [view_camera(camera, source) for camera, source in zip(stored.values(), sources, strict=True)]
    return replace(scene, cameras=Cameras.cat(views, dim=1), names=tuple(stored), sizes=sizes)


def commonest_size(cameras: Iterable[StoredCamera]) -> tuple[int, int]:
    """The height and width that most cameras have; of two equally frequent ones the wider, as of photographs."""
    sizes = Counter(camera.size for camera in cameras)
    return max(sizes, key=lambda size: (sizes[size], size[::-1]))


def cameras_beside(path: Path, stored_in: str | None, scene: StyledScene, own_up: str) -> dict[str, StoredCamera]:
    """The cameras stored in a folder, or else beside a file or one folder above; empty where there are none.

    A PLY of 3DGS in ``point_cloud/iteration_N`` has those of its run. They are moved to the scene: without its offset,
    to the frame of nerfstudio's model where ``dataparser_transforms.json`` says it, and else out of the file's own axes
    where they are in these.

    Args:
        path: The scene's file.
        stored_in: The folder, if one is given.
        scene: In OpenCV's axes.
        own_up: Axes of the file itself.
    """
    folders = [path.parent, path.parent.parent] if stored_in is None else [Path(stored_in)]
    if stored_in is None and path.parent.name.startswith("iteration_"):
        folders.append(path.parent.parent.parent)
    for folder in folders:
        file = folder / "cameras.json"
        is_own = file.is_file() and b'"world_from_camera"' in file.read_bytes()[:4096]  # and not of another program
        stored = own_cameras(file) if is_own else stored_cameras(folder)
        frames = (each / "dataparser_transforms.json" for each in (folder, *folders))
        if stored and (frame := next(filter(Path.is_file, frames), None)) is not None:
            return _in_model(_without(scene.offset, stored), frame, own_up)
        if stored:
            alike = is_own or own_up == "opencv"
            return _without(scene.offset, stored) if alike else _turned(stored, scene, own_up)
    return {}


def _without(offset: Offset, stored: dict[str, StoredCamera]) -> dict[str, StoredCamera]:
    """Cameras without the offset of the scene, where they have it."""
    centers = np.array([camera.world_from_camera[:3, 3] for camera in stored.values()]).reshape(-1, 3)
    if np.abs(centers - offset).sum() >= np.abs(centers).sum():
        return stored
    one = torch.ones((), dtype=torch.float64)
    return _moved(stored, Similarity(one, torch.eye(3).double(), -torch.tensor(offset, dtype=torch.float64)))


def _moved(stored: dict[str, StoredCamera], similarity: Similarity) -> dict[str, StoredCamera]:
    """Cameras in another frame."""
    return {
        name: replace(each, world_from_camera=similarity.poses(torch.from_numpy(each.world_from_camera)).numpy())
        for name, each in stored.items()
    }


def _in_model(stored: dict[str, StoredCamera], file: Path, own_up: str) -> dict[str, StoredCamera]:
    """Cameras in the frame of the splat that ``ns-export`` wrote, by the file of that frame."""
    frame = read_json(file, _ModelFrame, what="frame of nerfstudio's model")
    matrix, scale = torch.tensor(frame.transform, dtype=torch.float64), torch.tensor(frame.scale, dtype=torch.float64)
    rotation = matrix[:, :3]
    if (rotation @ rotation.T - torch.eye(3)).abs().max() > 1e-3:
        raise UserError(f"{file}: transform has no rotation in it")
    _log.warning("the cameras are moved to the frame of nerfstudio's model by %s", file)
    return _moved(stored, turn(own_up, "opencv", scale).after(Similarity(scale, rotation, scale * matrix[:, 3])))


def _turned(stored: dict[str, StoredCamera], scene: StyledScene, own_up: str) -> dict[str, StoredCamera]:
    """Cameras turned as the scene was from its file's axes, if they see far more of it then; without its offset."""
    axes = turn(own_up, "opencv", torch.zeros((), dtype=torch.float64))
    given, turned = (_without(scene.offset, cameras) for cameras in (stored, _moved(stored, axes)))
    alone, together = _seen(scene, given), _seen(scene, turned)
    both = together > MORE * alone
    told = "turned with them" if both else "taken to be in OpenCV's axes"
    line = "the Gaussians are turned, for %s is up in their file, and the cameras beside it %s: turned they see %.0f%% "
    line += "of the Gaussians, as given %.0f%%; splat.up=opencv turns neither"
    _log.warning(line, own_up, told, 100 * together, 100 * alone)
    return turned if both else given


def _seen(scene: StyledScene, stored: Mapping[str, StoredCamera]) -> float:
    """The share of a scene's Gaussians that a camera sees, on average, of up to a thousand of them."""
    means = scene.styles[-1][1].means[0]
    _, inside = projected(means[:: -(-len(means) // 1000)], with_cameras(scene, stored).cameras)
    return float(inside.double().mean())


def saved_cameras(saved: StyledScene) -> dict[str, StoredCamera]:
    """The cameras of a saved scene by the name of their view, in pixels of what was photographed."""
    size = saved.cameras.size
    named = zip(distinct(saved.names), saved.sizes or [size] * len(saved.names), strict=True)
    sources = [SourceImage.covering(name, own, size, whole=True) for name, own in named]
    poses, intrinsics = saved.cameras.world_from_camera[0].double(), saved.cameras.intrinsics[0].double()
    matrices = [source.source_intrinsics(each).numpy() for source, each in zip(sources, intrinsics, strict=True)]
    stored = zip(sources, poses.numpy(), matrices, strict=True)
    return {source.name: StoredCamera(pose, matrix, source.size) for source, pose, matrix in stored}


def own_cameras(path: Path) -> dict[str, StoredCamera]:
    """The cameras of ``cameras.json``."""
    views = read_json(path, SavedCameras, what="file of cameras").views
    return {
        name: StoredCamera(np.array(view.world_from_camera), np.array(view.intrinsics), (view.height, view.width))
        for name, view in zip(distinct([view.name for view in views]), views, strict=True)
    }
