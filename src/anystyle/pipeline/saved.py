"""The files of a scene besides renders, and reading them back: a folder of results, or a file of Gaussians."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import numpy as np
import torch
from jaxtyping import Float
from msgspec import Meta
from safetensors import SafetensorError, safe_open
from torch import Tensor

from anystyle.contracts import Format, StoredCamera
from anystyle.data.images import open_image
from anystyle.data.names import distinct, names_below, short_names
from anystyle.data.poses import stored_cameras
from anystyle.errors import UserError
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.transforms import Similarity
from anystyle.io.atomic import write_json
from anystyle.io.checkpoint import save_tensors
from anystyle.io.documents import read_json, read_text, regular
from anystyle.io.splats import NEAR, Offset
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.inputs import OWN, scene_format
from anystyle.ranges import Count
from anystyle.registry.build import build
from anystyle.types import Cameras, Gaussians, SourceImage, StyledScene
from anystyle.vision import weights

UNSTYLED = "unstyled"
PICTURE = "style.jpg"
"""A small picture of the style, where it is an image."""
CHOSEN = ("chosen", "chosen around the scene")
"""What a report says of cameras that are not those of photographs, since 0.2 and before."""
CONVENTION = "OpenCV axes (x right, y down, z forward); intrinsics in source pixels; lengths in the scene's own unit"
MAX_POINTS = 100_000
"""Points of a COLMAP export: what an optimisation of Gaussians starts from."""
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
    reconstruction: dict[str, object] = field(default_factory=dict)
    size: tuple[_Side, _Side] | None = None
    licenses: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    offset: Offset = NEAR


def save_gaussians(gaussians: Gaussians, path: Path) -> None:
    """Write every tensor of some Gaussians, without the loss of the PLY's conventions, as safetensors."""
    tensors = {item.name: getattr(gaussians, item.name).detach().cpu().contiguous() for item in fields(gaussians)}
    save_tensors(path, tensors, {"format": "anystyle/1 gaussians"})


def write_cameras(
    path: Path,
    cameras: Cameras,
    sources: Sequence[SourceImage],
    offset: Offset = NEAR,
    scene_from_known: Similarity | None = None,
) -> None:
    """Write the cameras of views as readable JSON, with intrinsics in pixels of their sources.

    Where known cameras were given, the similarity from their frame to the scene's is written as well.
    """
    matrices = zip(_source_intrinsics(cameras, sources), cameras.world_from_camera[0], strict=True)
    views = [
        {"name": source.name, "height": source.size[0], "width": source.size[1]}
        | {"intrinsics": intrinsics.tolist(), "world_from_camera": pose.tolist()}
        for source, (intrinsics, pose) in zip(sources, matrices, strict=True)
    ]
    content: dict[str, object] = {"convention": CONVENTION, "views": views}
    if any(offset):
        content["offset"] = {"meaning": "to add to all positions", "xyz": offset}
    if scene_from_known is not None:
        content["scene_from_known"] = {
            "meaning": "scene = scale * rotation @ known + translation",
            **{name: value.tolist() for name, value in scene_from_known._asdict().items()},
        }
    write_json(path, content)


def write_colmap(
    folder: Path, gaussians: Gaussians, cameras: Cameras, sources: Sequence[SourceImage], *, binary: bool
) -> None:
    """Write one scene as a COLMAP model: cameras in source pixels, images, and the most opaque Gaussians as points."""
    from anystyle.io import colmap

    opacities, cameras = gaussians.opacities[0].cpu(), cameras.to(torch.float64)
    most_opaque = opacities.argsort(descending=True, stable=True)[: min(MAX_POINTS, int((opacities > 0).sum()))]
    rgb = rgb_from_constant(gaussians.harmonics[0, :, 0].cpu()[most_opaque])
    paths = [source.path for source in sources if source.path is not None]
    files = dict(zip(paths, names_below(paths), strict=True))
    model = colmap.pinhole_model(
        [f"{source.name}.png" if source.path is None else files[source.path] for source in sources],
        [source.size for source in sources],
        _source_intrinsics(cameras, sources).numpy(),
        cameras.camera_from_world[0].numpy(),
        gaussians.means[0].cpu()[most_opaque].double().numpy(),
        (rgb.clamp(0, 1) * 255).round().byte().numpy(),
    )
    colmap.write(model, folder, binary=binary)


def _source_intrinsics(cameras: Cameras, sources: Sequence[SourceImage]) -> Float[Tensor, "V 3 3"]:
    pairs = zip(sources, cameras.intrinsics[0], strict=True)
    return torch.stack([source.source_intrinsics(matrix) for source, matrix in pairs])


def unstyled_of(scene: StyledScene) -> Gaussians:
    """The scene itself; where it was not saved, the last of the styles."""
    return dict(scene.styles).get(UNSTYLED, scene.styles[-1][1])


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
            poses = np.stack([camera.world_from_camera for camera in alike.values()])
            intrinsics = np.stack([camera.intrinsics for camera in alike.values()])
            cameras = Cameras(torch.from_numpy(poses).float()[None], torch.from_numpy(intrinsics).float()[None], size)
            names = tuple(short_names([PurePosixPath(name) for name in alike]))
            return replace(scene, cameras=cameras, names=names)
    return scene


def cameras_beside(folder: Path, offset: Offset) -> dict[str, StoredCamera]:
    """The cameras that are stored in a folder, without the offset of the scene where they have it."""
    stored = stored_cameras(folder)
    centers = np.array([camera.world_from_camera[:3, 3] for camera in stored.values()]).reshape(-1, 3)
    if np.abs(centers - offset).sum() >= np.abs(centers).sum():
        return stored
    shift = np.pad(np.array(offset)[:, None], ((0, 1), (3, 0)))
    return {
        name: replace(camera, world_from_camera=camera.world_from_camera - shift) for name, camera in stored.items()
    }


def read_unturned(path: Path, up: str | None, *, activated: bool = False) -> StyledScene:
    """Read a folder of results, or a file of Gaussians in its own axes, which are ``up`` or what it says.

    ``activated`` files hold lengths and opacities in [0, 1] where their format has logarithms and logits.
    """
    if not path.exists():
        raise UserError(f"there is no file or folder {path}")
    if path.suffix.lower() == OWN and path.is_file():
        gaussians, folder = read_gaussians(path), path.parent
        if not (folder / "report.json").is_file():
            return StyledScene(((path.stem, gaussians),), up=up or "opencv")
        whole = read_unturned(folder, None)
        title = UNSTYLED if path.stem == UNSTYLED else whole.styles[-1][0]
        return replace(whole, styles=((title, gaussians),))
    if name := scene_format(path):
        scene = build(Format, name, activated=activated).read(path)
        notes, beside = scene.notes, path.with_suffix(path.suffix + ".txt")
        notes = notes or (tuple(read_text(beside).splitlines()) if beside.is_file() else ())
        return replace(scene, notes=notes, up=up or scene.up, photographed=_photographed(_reports_of(path)))
    if not (path / "report.json").is_file():
        raise UserError(f"{path} has no scene that anystyle stylize wrote, and is not a file of a format that is read")
    whole = _report(path)
    # A folder may hold results of earlier runs beside those that its report is of.
    folders = [path] if isinstance(whole.style, str) else sorted(file.parent for file in path.glob("*/report.json"))
    titles = [whole.style] if isinstance(whole.style, str) else whole.style
    reports = {folder: report for folder in folders if (report := _report(folder)).style in titles}
    styles = [(str(report.style), read_gaussians(folder / "scene.safetensors")) for folder, report in reports.items()]
    if not styles:
        raise UserError(f"{path / 'report.json'} lists results that are missing")
    unstyled = path / "unstyled.safetensors"
    if unstyled.is_file():
        styles.insert(0, (UNSTYLED, read_gaussians(unstyled)))
    first, report = next(iter(reports.items()))
    cameras, names = _cameras(first / "cameras.json")
    made = f"{report.gaussians} Gaussians of {report.views} photographs, by anystyle."
    notes = (made, *weights.license_lines(report.licenses), *report.notes)
    given = {str(report.style): folder / PICTURE for folder, report in reports.items()}
    pictures = {title: open_image(file) for title, file in given.items() if file.is_file()}
    shared = {"offset": whole.offset, "pictures": pictures, "photographed": _photographed([report])}
    return StyledScene(tuple(styles), cameras, names, notes, **shared)


def _report(folder: Path) -> SavedReport:
    return read_json(folder / "report.json", SavedReport, what="report")


def made_at(path: Path) -> int | None:
    """The shorter side in pixels of the views of results in a folder, or beside a file; ``None`` if it is unknown."""
    return next((min(report.size) for report in _reports_of(path) if report.size), None)


def _reports_of(path: Path) -> Iterator[SavedReport]:
    """The reports of results in a folder, or of those that a file is part of."""
    if path.is_dir():
        folders = [path, *sorted(file.parent for file in path.glob("*/report.json"))]
    else:  # a report beside a stranger's file may be of anything
        ours = any((path.parent / name).is_file() for name in ("scene.safetensors", "unstyled.safetensors"))
        folders = [path.parent] if ours else []
    return (_report(folder) for folder in folders if (folder / "report.json").is_file())


def _photographed(reports: Iterable[SavedReport]) -> bool:
    """Whether no report says that the cameras were chosen."""
    return all(report.reconstruction.get("cameras") not in CHOSEN for report in reports)


def read_gaussians(path: Path) -> Gaussians:
    """Read what :func:`save_gaussians` wrote."""
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
