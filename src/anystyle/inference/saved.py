"""Scenes that were saved: what ``anystyle stylize`` leaves in a folder, or a PLY file of anybody."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any

import torch
from msgspec import Meta
from safetensors import SafetensorError, safe_open

from anystyle.data.poses import StoredCamera
from anystyle.documents import Count, read_json, regular
from anystyle.geometry.cameras import look_at
from anystyle.inference.export import from_axes
from anystyle.perception import weights
from anystyle.types import Cameras, Gaussians

_OPEN = ("Apache", "MIT", "BSD", "CC0", "CC-BY-4.0")
_CLOSED = ("NC", "non-commercial", "noncommercial", "research")


def licenses(loaded: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """By part of the model: its file, the terms it was given under, and what they mean for a result.

    Args:
        loaded: What was loaded, as :func:`anystyle.inference.assemble.assemble` says it: by part, with ``file``.
    """
    terms = {row.file: row.license for row in weights.files().values()}
    files = {part: str(entry["file"]) for part, entry in loaded.items()}
    return {
        part: {"file": file, "license": terms.get(file, "not stated"), "means": meaning(terms.get(file))}
        for part, file in files.items()
    }


def meaning(license: str | None) -> str:
    """What a licence of weights means for a scene made with them, in a sentence; no legal advice."""
    if license is not None and any(word in license for word in _CLOSED):
        return "results may not be used commercially"
    if license is not None and license.startswith(_OPEN):
        return "results may be used freely; whoever passes the weights on keeps their notice"
    return "the terms are not known here; ask whoever published the weights before results are passed on"


def lines(terms: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """For a file or a caption: a line for each part."""
    for part, entry in terms.items():
        yield f"{part}: {entry['file']}, {entry['license']}: {entry['means']}"


def report_entry(provenance: Mapping[str, object]) -> dict[str, dict[str, str]]:
    """The terms of what a report's provenance says was loaded; empty where it says nothing."""
    loaded = provenance.get("weights")
    return licenses(loaded) if isinstance(loaded, dict) else {}


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


@dataclass(frozen=True)
class SavedScene:
    """A scene in styles.

    Args:
        styles: Titles and Gaussians in OpenCV's axes, the unstyled scene first where it was saved.
        cameras: A batch of one scene; where none were saved, one that looks at all of it.
        names: Of the cameras.
        notes: Lines on where the scene comes from.
    """

    styles: tuple[tuple[str, Gaussians], ...]
    cameras: Cameras
    names: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def unstyled(self) -> Gaussians:
        """The scene itself; where it was not saved, the last of the styles."""
        return dict(self.styles).get(UNSTYLED, self.styles[-1][1])


def is_saved(path: Path) -> bool:
    """Whether this is a PLY file or a folder that ``anystyle stylize`` wrote, and no capture."""
    if path.is_dir():
        return (path / "report.json").is_file() and any(path.glob("*.safetensors"))
    return path.suffix.lower() == ".ply"


def read_saved(path: Path, up: str = "opencv") -> SavedScene:
    """Read a folder of results or a PLY file.

    Args:
        path: The folder or the file.
        up: The axes of a file, one of :data:`~anystyle.inference.export.UP`.

    Raises:
        ValueError: It is neither, or damaged.
    """
    if path.is_file():
        gaussians = from_axes(up, Gaussians.load(path))
        return SavedScene(((path.stem, gaussians),), looking_at(gaussians), ("all",), (path.name,))
    if not (path / "report.json").is_file():
        raise ValueError(f"{path} has no scene that anystyle stylize wrote, and is no PLY file")
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
        raise ValueError(f"{path / 'report.json'} tells of results that are not there")
    unstyled = path / "unstyled.safetensors"
    if unstyled.is_file():
        styles.insert(0, (UNSTYLED, read_gaussians(unstyled)))
    cameras, names = _cameras(folders[0] / "cameras.json")
    return SavedScene(tuple(styles), cameras, names, tuple(_notes(reports[0])))


def looking_at(gaussians: Gaussians, size: tuple[int, int] = (600, 800)) -> Cameras:
    """A camera that shows the middle of a scene, from where 3DGS's axes look: along z, y down."""
    visible = gaussians.means[0][gaussians.opacities[0] > 0.1]
    points = visible if len(visible) else gaussians.means[0]
    center = points.median(0).values
    radius = (points - center).norm(dim=-1).quantile(0.8) if len(points) < 2**23 else points.std()
    eye = center - torch.tensor([0.0, 0.0, 2.0]) * radius.clamp_min(1e-3)
    height, width = size
    focal = float(width)
    intrinsics = torch.tensor([[focal, 0.0, width / 2], [0.0, focal, height / 2], [0.0, 0.0, 1.0]])
    return Cameras(look_at(eye[None], center[None])[None], intrinsics[None, None], size)


def read_gaussians(path: Path) -> Gaussians:
    """Read what :func:`anystyle.inference.results.save_gaussians` wrote.

    Raises:
        ValueError: It is damaged, or another file.
    """
    try:
        with safe_open(regular(path, most=None), framework="pt") as file:
            return Gaussians(**{item.name: file.get_tensor(item.name) for item in fields(Gaussians)})
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} holds no Gaussians of anystyle ({error})") from None


def results_cameras(folder: Path) -> dict[str, StoredCamera]:
    """The cameras of a folder of results by the name of their view.

    Raises:
        ValueError: The folder is none, or damaged.
    """
    saved = read_saved(folder)
    poses, intrinsics = saved.cameras.world_from_camera[0].double(), saved.cameras.intrinsics[0].double()
    stored = zip(saved.names, poses.numpy(), intrinsics.numpy(), strict=True)
    return {name: StoredCamera(pose, matrix, saved.cameras.size) for name, pose, matrix in stored}


def _cameras(path: Path) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras of ``cameras.json``, those of one size as the first."""
    views = read_json(path, SavedCameras, what="file of cameras").views
    first = views[0]
    alike = [view for view in views if (view.height, view.width) == (first.height, first.width)]
    poses = torch.tensor([view.world_from_camera for view in alike], dtype=torch.float32)
    intrinsics = torch.tensor([view.intrinsics for view in alike], dtype=torch.float32)
    return Cameras(poses[None], intrinsics[None], (first.height, first.width)), tuple(view.name for view in alike)


def _notes(report: "SavedReport") -> Iterator[str]:
    yield f"{report.gaussians} Gaussians of {report.views} photographs, by anystyle."
    yield from lines(report.licenses)
