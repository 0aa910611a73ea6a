"""A scene that is given as Gaussians: reading it, cameras for it, and its renders as views."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np
import torch
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.data.folder import covering
from anystyle.data.names import short_names
from anystyle.data.poses import view_camera
from anystyle.geometry.cameras import look_at
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.io.splats import Offset
from anystyle.methods.colors import first_render
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.provenance import Entry, entry
from anystyle.pipeline.saved import cameras_beside, made_at, read_unturned, saved_cameras, unstyled_of
from anystyle.pipeline.stages import Stages
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians, Geometry, Scene, SourceImage, StyledScene, Views

ELEVATIONS = (10.0, 35.0)
"""Degrees above the scene's middle, of two rings of chosen cameras."""
FOCAL = 1.2
"""Of chosen cameras, in sides of their square images: 45 degrees."""
DISTANCE = 3.0
"""Of chosen cameras from the middle, in radii."""
PAINTED = 384
"""Shorter side in pixels at which a scene of unknown origin is painted, as photographs of a fit are."""
CameraOrigin = Literal["stored", "chosen"]
"""Where cameras come from: stored beside the scene as those of photographs, or chosen around it."""


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
    with stages("read", "the Gaussians"):
        given = read_unturned(path, options.up, activated=options.activated)
        saved = in_axes("opencv", given)
        sees_features = stylizer.branch.gaussian_head is not None
        side = made_at(path) or (stylizer.backbone.resolution if sees_features else PAINTED)
        cameras, sources, origin = cameras_of(path, saved, views, options, stylizer.backbone.patch_size, side)
        made_of = (entry("scene", [path if path.is_file() else path / "report.json"]),)
    file = path if path.is_file() and given.up == "opencv" and not options.activated else None
    return ReadSplat(unstyled_of(saved), cameras, sources, origin, file, given.notes, made_of, saved.offset)


def cameras_of(
    path: Path, saved: StyledScene, views: ViewOptions, options: SplatOptions, multiple: int, side: int
) -> tuple[Cameras, tuple[SourceImage, ...], CameraOrigin]:
    """The cameras to see a scene from, evenly spaced of those stored with it or beside its file, or else around it.

    Sides of renders are multiples of ``multiple``; the shorter is ``side`` unless ``views`` give it. Beside the
    cameras it returns what their images are called, and where they come from.
    """
    side = max(multiple, round((views.short_side or side) / multiple) * multiple)
    stored = {} if options.folder else saved_cameras(saved)
    for folder in [Path(options.folder)] if options.folder else [path.parent, path.parent.parent]:
        stored = stored or cameras_beside(folder, saved.offset)
    if not stored:
        names = [f"view_{index:02d}" for index in range(options.cameras)]
        sources = tuple(covering(name, (side, side), (side, side)) for name in names)
        return around(unstyled_of(saved), options.cameras, side), sources, "chosen"
    names = list(stored)
    chosen = torch.linspace(0, len(names) - 1, min(len(names), options.cameras)).round().int().unique().tolist()
    whole = stored[names[chosen[0]]].size
    height, width = (max(multiple, round(length * side / min(whole) / multiple) * multiple) for length in whole)
    called = short_names([path.parent / path.stem for path in map(PurePosixPath, names)])
    sources = tuple(covering(called[index], stored[names[index]].size, (height, width)) for index in chosen)
    cameras = [view_camera(stored[names[index]], source) for index, source in zip(chosen, sources, strict=True)]
    return Cameras.cat(cameras, dim=1), sources, "stored" if saved.photographed else "chosen"


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
    radius = quantile((means - middle).norm(dim=1), 0.8)
    turn = 2 * torch.pi * torch.arange(number, dtype=torch.float32) / number
    rise = torch.deg2rad(torch.tensor(ELEVATIONS))[torch.arange(number) % len(ELEVATIONS)]
    towards = torch.stack([rise.cos() * turn.cos(), -rise.sin(), rise.cos() * turn.sin()], dim=1).to(means)
    eye = middle + DISTANCE * radius * towards
    intrinsics = torch.tensor([[FOCAL * side, 0.0, side / 2], [0.0, FOCAL * side, side / 2], [0.0, 0.0, 1.0]])
    return Cameras(
        look_at(eye, middle.expand_as(eye))[None], intrinsics.expand(1, number, 3, 3).to(means), (side, side)
    )


@torch.no_grad()
def scene_of_splat(
    gaussians: Gaussians,
    cameras: Cameras,
    renderer: Renderer,
    encode: Callable[[Views], Scene],
) -> Scene:
    """The renders of given Gaussians, a batch of one, encoded with known cameras, as a scene that has these."""
    renders = [first_render(gaussians, cameras.select([view]), renderer) for view in range(cameras.intrinsics.shape[1])]
    images, alpha = (torch.cat([getattr(render, name) for render in renders], dim=1) for name in ("color", "alpha"))
    depth = torch.cat([render.depth for render in renders], dim=1) / alpha.clamp_min(1e-6)
    views = Views(images.clamp(0, 1), cameras)
    encoded = encode(views)
    # The colours that are styled are those of the renders, as the encoder saw them.
    color = constant_from_rgb(views.images.movedim(2, -1))[..., None]
    return replace(
        encoded,
        geometry=Geometry(cameras, depth, alpha),
        attributes=replace(encoded.attributes, color=color.to(encoded.attributes.color.dtype)),
        clusters=None,
        gaussians=gaussians,
    )
