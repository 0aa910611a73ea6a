"""Reading saved scenes: a folder that ``anystyle stylize`` wrote, or a file of Gaussians."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
import torch
from msgspec import Meta
from safetensors import SafetensorError, safe_open

from anystyle.contracts import Format, StoredCamera
from anystyle.data.names import distinct, short_names
from anystyle.data.poses import stored_cameras
from anystyle.errors import UserError
from anystyle.io import video
from anystyle.io.documents import read_json, read_text, regular
from anystyle.io.splats import NEAR, Offset
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.provenance import MADE_OF, note
from anystyle.ranges import Count
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle.vision import weights

UNSTYLED = "unstyled"
_Row3 = tuple[float, float, float]
_Row4 = tuple[float, float, float, float]
_Side = Annotated[int, Meta(gt=0, le=100_000)]


@dataclass(frozen=True)
class SavedCamera:
    """A view in ``cameras.json``."""

    name: str
    height: _Side
    width: _Side
    intrinsics: tuple[_Row3, _Row3, _Row3]
    world_from_camera: tuple[_Row4, _Row4, _Row4, _Row4]


@dataclass(frozen=True)
class SavedCameras:
    """``cameras.json``."""

    views: Annotated[list[SavedCamera], Meta(min_length=1)]


@dataclass(frozen=True)
class SavedReport:
    """What is read of ``report.json``."""

    style: str | list[str] = ""
    gaussians: Count = 0
    views: Count = 0
    licenses: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    offset: Offset = NEAR
    provenance: list[dict[str, object]] = field(default_factory=list)


def unstyled_of(scene: StyledScene) -> Gaussians:
    """The scene itself; where it was not saved, the last of the styles."""
    return dict(scene.styles).get(UNSTYLED, scene.styles[-1][1])


def is_scene_file(path: Path) -> bool:
    """Whether a plugin of kind ``format`` has the file's suffix as its name, and it is not a film, which is views."""
    suffix = path.suffix.lower()
    return suffix[1:] in catalog().names("format") and suffix not in video.SUFFIXES


def read_saved(path: Path, up: str | None = None, *, activated: bool = False) -> StyledScene:
    """Read a folder of results, or a file of Gaussians by the plugin of its suffix, and turn it to OpenCV's axes."""
    return in_axes("opencv", read_unturned(path, up, activated=activated))


def with_stored_cameras(scene: StyledScene, path: Path, stored_in: str | None = None) -> StyledScene:
    """A scene with the cameras beside its file or one folder above, those of one size, where it has none of its own."""
    folders = (path.parent, path.parent.parent) if stored_in is None else (Path(stored_in),)
    for folder in () if scene.names else folders:
        if (file := folder / "cameras.json").is_file():
            cameras, names = _cameras(file)
            return replace(scene, cameras=cameras, names=names)
        if stored := cameras_beside(folder, scene.offset):
            size = next(iter(stored.values())).size
            alike = {name: camera for name, camera in stored.items() if camera.size == size}
            matrices = ([getattr(c, part) for c in alike.values()] for part in ("world_from_camera", "intrinsics"))
            poses, intrinsics = (torch.from_numpy(np.stack(each)).float()[None] for each in matrices)
            return replace(
                scene,
                cameras=Cameras(poses, intrinsics, size),
                names=tuple(short_names([PurePosixPath(name) for name in alike])),
            )
    return scene


def cameras_beside(folder: Path, offset: Offset) -> dict[str, StoredCamera]:
    """The cameras that are stored in a folder, without the offset of the scene where they have it."""
    stored = stored_cameras(folder)
    shift = np.zeros((4, 4))
    shift[:3, 3] = offset
    centers = np.array([camera.world_from_camera[:3, 3] for camera in stored.values()]).reshape(-1, 3)
    if np.abs(centers - offset).sum() >= np.abs(centers).sum():
        return stored
    moved = {name: camera.world_from_camera - shift for name, camera in stored.items()}
    return {name: replace(camera, world_from_camera=moved[name]) for name, camera in stored.items()}


def read_unturned(path: Path, up: str | None, *, activated: bool = False) -> StyledScene:
    """Read a folder of results, or a file of Gaussians as it is.

    Args:
        path: The folder or the file.
        up: The axes of a file, one of :data:`~anystyle.pipeline.options.AXES`; ``None`` is what it says.
        activated: Whether a file holds lengths and opacities in [0, 1] where its format has logarithms and logits.
    """
    if path.is_file() and is_scene_file(path):
        scene = build(Format, path.suffix[1:].lower(), activated=activated).read(path)
        notes, beside = scene.notes, path.with_suffix(path.suffix + ".txt")
        notes = notes or (tuple(read_text(beside).splitlines()) if beside.is_file() else ())
        if not any(line.startswith(MADE_OF) for line in notes):
            notes = (*notes, note("scene", [path]))
        return replace(scene, notes=notes, up=up or scene.up)
    if not (path / "report.json").is_file():
        raise UserError(f"{path} has no scene that anystyle stylize wrote, and is no file of a format that is read")
    whole = read_json(path / "report.json", SavedReport, what="report")
    # A folder may hold results of earlier runs beside those that its report is of.
    folders = [path] if isinstance(whole.style, str) else sorted(file.parent for file in path.glob("*/report.json"))
    reports = [read_json(folder / "report.json", SavedReport, what="report") for folder in folders]
    styles = [
        (str(report.style), read_gaussians(folder / "scene.safetensors"))
        for folder, report in zip(folders, reports, strict=True)
        if report.style in (whole.style if isinstance(whole.style, list) else [whole.style])
    ]
    if not styles:
        raise UserError(f"{path / 'report.json'} lists results that are missing")
    unstyled = path / "unstyled.safetensors"
    if unstyled.is_file():
        styles.insert(0, (UNSTYLED, read_gaussians(unstyled)))
    cameras, names = _cameras(folders[0] / "cameras.json")
    return StyledScene(tuple(styles), cameras, names, tuple(_notes(reports[0], whole)), offset=whole.offset)


def read_gaussians(path: Path) -> Gaussians:
    """Read what :func:`anystyle.pipeline.scene_files.save_gaussians` wrote."""
    try:
        with safe_open(regular(path, most=None), framework="pt") as file:
            return Gaussians(**{item.name: file.get_tensor(item.name) for item in fields(Gaussians)})
    except (SafetensorError, OSError) as error:
        raise UserError(f"{path} holds no Gaussians of anystyle ({error})") from None


def saved_cameras(saved: StyledScene) -> dict[str, StoredCamera]:
    """The cameras of a saved scene by the name of their view."""
    poses, intrinsics = saved.cameras.world_from_camera[0].double(), saved.cameras.intrinsics[0].double()
    stored = zip(distinct(saved.names), poses.numpy(), intrinsics.numpy(), strict=True)
    return {name: StoredCamera(pose, matrix, saved.cameras.size) for name, pose, matrix in stored}


def _cameras(path: Path) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras of ``cameras.json``, those of one size as the first."""
    views = read_json(path, SavedCameras, what="file of cameras").views
    first = views[0]
    alike = [view for view in views if (view.height, view.width) == (first.height, first.width)]
    poses = torch.tensor([view.world_from_camera for view in alike], dtype=torch.float32)
    intrinsics = torch.tensor([view.intrinsics for view in alike], dtype=torch.float32)
    return Cameras(poses[None], intrinsics[None], (first.height, first.width)), tuple(view.name for view in alike)


def _notes(report: SavedReport, whole: SavedReport) -> Iterator[str]:
    yield f"{report.gaussians} Gaussians of {report.views} photographs, by anystyle."
    yield from (*weights.license_lines(report.licenses), *report.notes)
    yield from (MADE_OF + json.dumps(table) for table in whole.provenance)
