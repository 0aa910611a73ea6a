"""Scenes that were saved: what ``anystyle stylize`` leaves in a folder, or a PLY file of anybody."""

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open

from anystyle.geometry.cameras import look_at
from anystyle.inference.licenses import lines
from anystyle.types import Cameras, Gaussians

UNSTYLED = "unstyled"


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


def read_saved(path: Path) -> SavedScene:
    """Read a folder of results or a PLY file.

    Raises:
        ValueError: It is neither, or damaged.
    """
    if path.is_file():
        gaussians = Gaussians.load(path)
        return SavedScene(((path.stem, gaussians),), looking_at(gaussians), ("all",), (path.name,))
    folders = [folder for folder in [path, *sorted(path.glob("*/"))] if (folder / "scene.safetensors").is_file()]
    if not folders:
        raise ValueError(f"{path} has no scene that anystyle stylize wrote, and is no PLY file")
    reports = [_document(folder / "report.json") for folder in folders]
    styles = [
        (str(report.get("style", folder.name)), read_gaussians(folder / "scene.safetensors"))
        for folder, report in zip(folders, reports, strict=True)
    ]
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
        with safe_open(path, framework="pt") as file:
            return Gaussians(**{item.name: file.get_tensor(item.name) for item in fields(Gaussians)})
    except (SafetensorError, OSError) as error:
        raise ValueError(f"{path} holds no Gaussians of anystyle ({error})") from None


def _cameras(path: Path) -> tuple[Cameras, tuple[str, ...]]:
    """The cameras of ``cameras.json``, those of one size as the first."""
    views = _document(path).get("views")
    try:
        first = views[0]
        size = (int(first["height"]), int(first["width"]))
        alike = [view for view in views if (view["height"], view["width"]) == size]
        poses = torch.tensor([view["world_from_camera"] for view in alike], dtype=torch.float32)
        intrinsics = torch.tensor([view["intrinsics"] for view in alike], dtype=torch.float32)
        cameras = Cameras(poses.reshape(1, -1, 4, 4), intrinsics.reshape(1, -1, 3, 3), size)
    except (KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} is no file of cameras ({type(error).__name__}: {error})") from None
    return cameras, tuple(str(view["name"]) for view in alike)


def _document(path: Path) -> Mapping[str, Any]:
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is no JSON ({error})") from None
    return content if isinstance(content, dict) else {}


def _notes(report: Mapping[str, Any]) -> Iterator[str]:
    yield f"{report.get('gaussians', '?')} Gaussians of {report.get('views', '?')} photographs, by anystyle."
    licenses = report.get("licenses")
    if isinstance(licenses, dict):
        yield from lines({part: entry for part, entry in licenses.items() if isinstance(entry, dict)})
