"""A saved scene, which is a folder of results or a file of Gaussians: reading it, and cameras and views of it."""

import logging
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
import torch
import torch.nn.functional as F
from safetensors import safe_open
from torch import Tensor

from anystyle.contracts import Format, Renderer
from anystyle.data.images import open_image
from anystyle.data.poses import view_camera
from anystyle.errors import UserError
from anystyle.geometry.cameras import look_at
from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.io.documents import parsing, read_json, read_text, regular
from anystyle.io.splats import NEAR, Offset
from anystyle.methods.colors import first_render, pixels_shown, with_gaussians
from anystyle.methods.simplify import simplified
from anystyle.paths import distinct, short_names
from anystyle.pipeline.beside import Side, cameras_beside, commonest_size, own_cameras, saved_cameras, with_cameras
from anystyle.pipeline.export import in_axes, turn
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.provenance import Entry, entry
from anystyle.pipeline.request import OWN, PICTURE, file_of, scene_format
from anystyle.pipeline.stages import Stages
from anystyle.ranges import Count
from anystyle.registry.build import build
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, Scene, SourceImage, StyledScene, Views
from anystyle.vision import weights

_log = logging.getLogger(__name__)
UNSTYLED = "unstyled"
CHOSEN = ("chosen", "chosen around the scene")
"""What a report says of cameras that are not those of photographs, since 0.2 and before."""
ELEVATIONS = (10.0, 35.0)
"""Degrees above the scene's middle, of two rings of chosen cameras."""
FOCAL = 1.2
"""Of chosen cameras, in sides of their square images: 45 degrees."""
DISTANCE = 3.0
"""Of chosen cameras from the middle, in radii."""
CANDIDATES, SMALL = 48, 96
"""Cameras around a scene of which some are chosen, and the side of their pictures in pixels."""
FACING = 0.65
"""Of the best camera's score: cameras of less look at a back, or at an edge."""
PAINTED = 384
"""Shorter side in pixels at which a scene of unknown origin is painted, as photographs of a fit are."""
COUNTED = 100_000
"""Gaussians, evenly spaced, that tell which axis is up."""
FLAT, LEVEL = 0.5, 1.5
"""A Gaussian is flat whose thinnest side is less than this share of the next; a floor has so many times as much of
what is flat across the axis that is up as there is across another."""
ABOVE, BELOW = 0.3, 0.03
"""Shares of a scene over and under its floor, by 0.2 standard deviations of heights, from which it counts as one."""
CameraOrigin = Literal["stored", "chosen"]
"""Where cameras come from: stored beside the scene as those of photographs, or chosen around it."""
_AS_IT_SAYS = SplatOptions()


@dataclass(frozen=True)
class SavedReport:
    """What is read of ``report.json``."""

    style: str | list[str] = ""
    gaussians: Count = 0
    views: Count = 0
    reconstruction: dict[str, object] = field(default_factory=dict)
    size: tuple[Side, Side] | None = None
    licenses: dict[str, dict[str, str]] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    offset: Offset = NEAR


def unstyled_of(scene: StyledScene) -> Gaussians:
    """The scene itself; where it was not saved, the last of the styles."""
    return dict(scene.styles).get(UNSTYLED, scene.styles[-1][1])


def read_saved(path: Path, options: SplatOptions = _AS_IT_SAYS) -> StyledScene:
    """Read a folder of results, or a file of Gaussians by the plugin of its suffix, and turn it to OpenCV's axes."""
    return in_axes("opencv", read_unturned(path, options))


def read_unturned(path: Path, options: SplatOptions = _AS_IT_SAYS) -> StyledScene:
    """Read a folder of results, or a file of Gaussians in its own axes; options are for files of other programs."""
    if not path.exists():
        raise UserError(f"there is no file or folder {path}")
    path = file_of(path)
    if path.suffix.lower() == OWN and path.is_file():
        gaussians, folder = read_gaussians(path), path.parent
        if not (folder / "report.json").is_file():
            return StyledScene(((path.stem, gaussians),), up=options.up or "opencv")
        whole = read_unturned(folder)
        title = UNSTYLED if path.stem == UNSTYLED else whole.styles[-1][0]
        return replace(whole, styles=((title, gaussians),))
    if name := scene_format(path):
        reader = build(Format, name, activated=options.activated)
        scene, beside = reader.read(path), path.with_suffix(path.suffix + ".txt")
        more = read_text(beside).splitlines() if beside.is_file() else []
        notes = scene.notes if reader.has_notes and scene.notes else tuple(dict.fromkeys([*scene.notes, *more]))
        mode = (scene.antialiased or _configured(path)) if options.antialiased is None else options.antialiased
        styles = tuple((title, gaussians.marked(mode)) for title, gaussians in scene.styles)
        shared = {"up": options.up or scene.up, "photographed": _photographed(_reports_of(path))}
        return replace(scene, styles=styles, notes=notes, **shared)
    if not (path / "report.json").is_file():
        raise UserError(f"{path} has no scene that anystyle stylize wrote, and is not a file of a format that is read")
    whole = _report(path)
    # A folder may hold results of earlier runs beside those that its report is of.
    folders = [path] if isinstance(whole.style, str) else sorted(file.parent for file in path.glob("*/report.json"))
    titles = [whole.style] if isinstance(whole.style, str) else whole.style
    reports = {folder: report for folder in folders if (report := _report(folder)).style in titles}
    shown = distinct([UNSTYLED, *(str(report.style) for report in reports.values())], " ")[1:]
    names = dict(zip(reports, shown, strict=True))
    styles = [(names[folder], read_gaussians(folder / "scene.safetensors")) for folder in reports]
    if not styles:
        raise UserError(f"{path / 'report.json'} lists results that are missing")
    unstyled = path / "unstyled.safetensors"
    if unstyled.is_file():
        styles.insert(0, (UNSTYLED, read_gaussians(unstyled)))
    first, report = next(iter(reports.items()))
    stored = own_cameras(first / "cameras.json")
    made = f"{report.gaussians} Gaussians of {report.views} photographs, by anystyle."
    notes = (made, *weights.license_lines(report.licenses), *report.notes)
    given = {names[folder]: folder / PICTURE for folder in reports}
    pictures = {title: open_image(file) for title, file in given.items() if file.is_file()}
    shared = {"offset": whole.offset, "pictures": pictures, "photographed": _photographed([report])}
    return with_cameras(StyledScene(tuple(styles), notes=notes, **shared), stored)


def _configured(path: Path) -> bool:
    """Whether the configuration of nerfstudio's run beside a file says that it was trained with antialiasing."""
    file = path.with_name("config.yml")
    return file.is_file() and re.search(r"^\s*rasterize_mode: antialiased\s*$", read_text(file), re.M) is not None


def _report(folder: Path) -> SavedReport:
    return read_json(folder / "report.json", SavedReport, what="report")


def made_at(path: Path) -> tuple[int, int] | None:
    """The height and width of the views of results in a folder, or beside a file; ``None`` if they are unknown."""
    return next((report.size for report in _reports_of(path) if report.size), None)


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
    with parsing(path, "file of Gaussians of anystyle"), safe_open(regular(path, most=None), framework="pt") as file:
        gaussians = Gaussians(**{item.name: file.get_tensor(item.name) for item in fields(Gaussians)})
        return gaussians.marked("antialiased" in (file.metadata() or {}))


@dataclass(frozen=True)
class ReadSplat:
    """Given Gaussians as they were read.

    Args:
        gaussians: A batch of one, in OpenCV's axes.
        cameras: Where they are seen from.
        sources: What the images of these cameras are called.
        origin: Where the cameras come from.
        file: The file itself, where results can be copies of it with other colours.
        notes: Lines of the file, such as licences.
        made_of: The file, for the report.
        offset: What was taken off the positions.
    """

    gaussians: Gaussians
    cameras: Cameras
    sources: tuple[SourceImage, ...]
    origin: CameraOrigin
    file: Path | None
    notes: tuple[str, ...]
    made_of: tuple[Entry, ...]
    offset: Offset


def read_splat(path: Path, stylizer: Stylizer, views: ViewOptions, options: SplatOptions, stages: Stages) -> ReadSplat:
    """Read a saved scene with cameras that are stored with it or chosen; of several styles the unstyled scene.

    Views have the size that ``views`` say, else that at which results were made.
    """
    path = file_of(path)
    with stages("read", "the Gaussians"):
        given = read_unturned(path, options)
        saved = in_axes("opencv", given)
        sees_features = stylizer.branch.gaussian_head is not None
        side = min(made_at(path) or [stylizer.backbone.resolution if sees_features else PAINTED])
        multiple, renderer = stylizer.backbone.patch_size, stylizer.renderer
        cameras, sources, origin = cameras_of(path, saved, views, options, renderer, multiple, side, given.up)
        made_of = (entry("scene", [path if path.is_file() else path / "report.json"]),)
        gaussians = tidied(whole := unstyled_of(saved), cameras, renderer, options)
    copied = path.is_file() and given.up == "opencv" and not options.activated and gaussians is whole
    return ReadSplat(gaussians, cameras, sources, origin, path if copied else None, given.notes, made_of, saved.offset)


def tidied(gaussians: Gaussians, cameras: Cameras, renderer: Renderer, options: SplatOptions) -> Gaussians:
    """Gaussians merged into fewer, as options ask; a line says what was done."""
    if options.max_gaussians is not None:
        count, gaussians = gaussians.means.shape[1], simplified(gaussians, cameras, renderer, options.max_gaussians)
        _log.warning("kept %s of %s Gaussians (merged)", f"{gaussians.means.shape[1]:,}", f"{count:,}")
    return gaussians


def cameras_of(
    path: Path,
    saved: StyledScene,
    views: ViewOptions,
    options: SplatOptions,
    renderer: Renderer,
    multiple: int,
    side: int,
    own_up: str = "opencv",
) -> tuple[Cameras, tuple[SourceImage, ...], CameraOrigin]:
    """The cameras to see a scene from, evenly spaced of those stored with it or beside its file, or else around it.

    ``renderer`` tells where around it most is seen. Sides of renders are multiples of ``multiple``; the shorter is
    ``side`` unless ``views`` give it. ``own_up`` are the axes of the file before it was turned to OpenCV's. Beside the
    cameras it returns what their images are called, and where they come from.
    """
    side = max(multiple, round((views.short_side or side) / multiple) * multiple)
    stored = {} if options.folder else saved_cameras(saved)
    stored = stored or cameras_beside(path, options.folder, saved, own_up)
    if not stored:
        gaussians, told, up = unstyled_of(saved), "", "opencv"
        if options.up is None and own_up == "opencv":
            up, told = _found_up(gaussians)
        upright = turn(up, "opencv", gaussians.means)
        cameras = facing(upright.gaussians(gaussians), options.cameras, side, renderer)
        cameras = replace(cameras, world_from_camera=upright.inverse().poses(cameras.world_from_camera))
        names = [f"view_{index:02d}" for index in range(cameras.intrinsics.shape[1])]
        sources = tuple(SourceImage.covering(name, (side, side), (side, side)) for name in names)
        line = "no cameras are in %s or beside it: %d are chosen around the scene, where most of it is seen; "
        line += "splat.folder=FOLDER reads those of the photographs%s"
        _log.warning(line, path.name, len(names), told)
        return cameras, sources, "chosen"
    names = list(stored)
    chosen = torch.linspace(0, len(names) - 1, min(len(names), options.cameras)).round().int().unique().tolist()
    whole = commonest_size(stored.values())
    height, width = (max(multiple, round(length * side / min(whole) / multiple) * multiple) for length in whole)
    called = short_names([path.parent / path.stem for path in map(PurePosixPath, names)])
    own = ((called[index], stored[names[index]].size) for index in chosen)
    sources = tuple(SourceImage.covering(name, size, (height, width), whole=True) for name, size in own)
    cameras = [view_camera(stored[names[index]], source) for index, source in zip(chosen, sources, strict=True)]
    return Cameras.cat(cameras, dim=1), sources, "stored" if saved.photographed else "chosen"


def _found_up(gaussians: Gaussians) -> tuple[str, str]:
    """The axes by which a scene stands upright, and a line on them; -y, OpenCV's, is up unless a floor says otherwise.

    Flat Gaussians across an axis are a floor where there is much above and nothing below; a wall has a floor before it.
    """
    every = max(1, gaussians.means.shape[1] // COUNTED)
    gaussians = gaussians.map(lambda tensor: tensor[:, ::every])
    turned = matrix_from_wxyz(F.normalize(gaussians.rotations[0].double(), dim=-1))  # N 3 3
    scales, thinnest = gaussians.scales[0].double().sort(dim=1)
    normals = turned.gather(2, thinnest[:, None, :1].expand(-1, 3, 1))[..., 0]  # N 3
    # Round Gaussians have no normal, and large ones are more of the surface, though the largest may be sky.
    area = scales[:, 1] * scales[:, 2]
    weights = gaussians.opacities[0] * area.clamp(max=float(area.quantile(0.9))) * (scales[:, 0] < FLAT * scales[:, 1])
    across = weights[:, None] * normals**4  # N 3
    shares, means, opacities = across.sum(0), gaussians.means[0].double(), gaussians.opacities[0].double()
    heights = (means - (across * means).sum(0) / shares.clamp_min(1e-12)) / (means.std(0, correction=0) + 1e-12)
    over, under = (((side * heights > 0.2) * opacities[:, None]).sum(0) / opacities.sum() for side in (1, -1))
    for axis, up in ((1, "y"), (2, "z")):
        if shares[axis] >= LEVEL * (shares.sum() - shares[axis]) and over[axis] > ABOVE and under[axis] < BELOW:
            return up, f"; {up} is taken to be up, for a floor lies across it: splat.up=opencv if it is -y"
    if not shares.sum() or shares[2] < LEVEL * shares[1]:
        return "opencv", "; up is taken to be -y, and splat.up=y or splat.up=z says that it is another axis"
    told = "; its surfaces lie mostly across z, and up is taken to be -y: splat.up=z if renders lie on their side"
    return "opencv", told


def facing(gaussians: Gaussians, number: int, side: int, renderer: Renderer) -> Cameras:
    """At most ``number`` of the cameras around a scene, where many Gaussians are seen in a full picture.

    The number of Gaussians that a camera shows, half as large at least as the camera that shows them largest, is
    multiplied by what they cover of its picture: behind a wall most are hidden, and beside one the picture is empty.
    """
    device = (*renderer.devices, "cpu")[0]
    ring = around(gaussians, max(CANDIDATES, number), SMALL)
    with torch.no_grad():
        shown = pixels_shown(gaussians.to(device), ring.to(device), renderer)  # V N
    score = (2 * shown >= shown.amax(0).clamp_min(1e-6)).sum(1) * shown.sum(1)
    score = score + score.roll(1) + score.roll(-1)  # of directions: the rings see unequally much
    kept = (score >= FACING * score.max()).nonzero()[:, 0].cpu()
    chosen = torch.linspace(0, len(kept) - 1, min(number, len(kept))).round().long()
    return ring.select(kept[chosen]).resized((side, side))


def around(gaussians: Gaussians, number: int, side: int) -> Cameras:
    """Cameras on two rings around the middle of a scene, looking at it; -y is up, as in OpenCV's axes.

    Middle and radius are medians weighted by opacity, so that a few floaters far away move neither.
    """
    # So that weights do not add up to 0 where every Gaussian is transparent.
    means, weights = gaussians.means[0], gaussians.opacities[0].double().clamp_min(1e-12).cpu().numpy()

    def quantile(values: Tensor, fraction: float) -> Tensor:
        data = values.cpu().numpy()
        return means.new_tensor(np.quantile(data, fraction, axis=0, weights=weights, method="inverted_cdf"))

    middle = quantile(means, 0.5)
    radius = quantile((means - middle).norm(dim=1) + gaussians.scales[0].amax(1), 0.8)
    turn = 2 * torch.pi * torch.arange(number, dtype=torch.float32) / number
    # By the golden ratio, so that every few of them, evenly spaced, are of both rings.
    ring = (len(ELEVATIONS) * (0.618034 * torch.arange(number) % 1)).long()
    rise = torch.deg2rad(torch.tensor(ELEVATIONS))[ring]
    towards = torch.stack([rise.cos() * turn.cos(), -rise.sin(), rise.cos() * turn.sin()], dim=1).to(means)
    eye = middle + DISTANCE * radius * towards
    intrinsics = torch.tensor([[FOCAL * side, 0.0, side / 2], [0.0, FOCAL * side, side / 2], [0.0, 0.0, 1.0]])
    return Cameras(
        look_at(eye, middle.expand_as(eye))[None], intrinsics.expand(1, number, 3, 3).to(means), (side, side)
    )


@torch.no_grad()
def splat_scene(gaussians: Gaussians, cameras: Cameras, renderer: Renderer, encode: Callable[[Views], Scene]) -> Scene:
    """The renders of given Gaussians, a batch of one, encoded with known cameras, as a scene that has these."""
    renders = [first_render(gaussians, cameras.select([view]), renderer) for view in range(cameras.intrinsics.shape[1])]
    images = torch.cat([render.color for render in renders], dim=1).clamp(0, 1)
    # The colours that are styled are those of the renders, as the encoder saw them.
    return with_gaussians(encode(Views(images, cameras)), gaussians, cameras, renders, images)
