"""Stylizing a given 3D Gaussian scene: cameras for it, and its renders as views."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np
import torch
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.data.folder import covering
from anystyle.data.names import short_names
from anystyle.data.poses import view_camera
from anystyle.geometry.cameras import look_at
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.io.limits import require
from anystyle.methods.colors import KEPT, first_render
from anystyle.pipeline.encode import EncodedCapture, Group, available, encoder, scene_report
from anystyle.pipeline.export import in_axes
from anystyle.pipeline.options import SplatOptions, ViewOptions
from anystyle.pipeline.provenance import entry
from anystyle.pipeline.saved import CHOSEN, cameras_beside, made_at, read_unturned, saved_cameras, unstyled_of
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
BYTES, BYTES_A_PIXEL = 800, 250
"""Memory that restyling takes: of each Gaussian of degree 3, and of each pixel of the views, with renderer=cpu."""


def encode_saved(
    path: Path, stylizer: Stylizer, views: ViewOptions, options: SplatOptions, stages: Stages
) -> EncodedCapture:
    """Read a saved scene, render it from cameras that are stored with it or chosen, and encode the renders.

    Of a folder of results in several styles the unstyled scene is taken. Renders have the size that ``views`` say, else
    that at which results were made.
    """
    start, patch = time.perf_counter(), stylizer.backbone.patch_size
    with stages("read", "the Gaussians"):
        given = read_unturned(path, options.up, activated=options.activated)
        saved = in_axes("opencv", given)
        gaussians = unstyled_of(saved).to(stylizer.device)
        sees_features = stylizer.branch.gaussian_head is not None
        side = made_at(path) or (stylizer.backbone.resolution if sees_features else PAINTED)
        cameras, sources, origin = cameras_of(path, saved, views, options, patch, side)
        line = require_splat(gaussians.means.shape[1], cameras, stylizer.device)
    with stages("encode", f"{line}; cameras {origin}"):
        scene = scene_of_splat(gaussians, cameras.to(stylizer.device), stylizer.renderer, encoder(stylizer))
    report = scene_report("given", len(sources), start, {}) | {"cameras": origin}
    seen = replace(scene.views, names=tuple(source.name for source in sources)).to("cpu")
    original = path if path.is_file() and given.up == "opencv" and not options.activated else None
    return EncodedCapture(
        stylizer,
        seen,
        sources,
        Group.whole(scene),
        report,
        splat=original,
        notes=given.notes,
        made_of=(entry("scene", [path if path.is_file() else path / "report.json"]),),
        offset=saved.offset,
    )


def require_splat(num_gaussians: int, cameras: Cameras, device: torch.device) -> str:
    """Refuse a scene that memory does not hold; a line on what it will take."""
    num_views, (height, width) = cameras.intrinsics.shape[1], cameras.size
    needed = num_gaussians * BYTES + min(num_views * height * width * BYTES_A_PIXEL, KEPT)
    what = f"{num_gaussians:,} Gaussians from {num_views} views"
    if (free := available(device)) is not None:
        require(needed, what, "give a scene of fewer Gaussians, or fewer views with splat.cameras", free)
    return f"{what} take about {needed / 2**30:.2g} GiB"


def cameras_of(
    path: Path, saved: StyledScene, views: ViewOptions, options: SplatOptions, multiple: int, side: int
) -> tuple[Cameras, tuple[SourceImage, ...], str]:
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
        return around(unstyled_of(saved), options.cameras, side), sources, CHOSEN
    names = list(stored)
    chosen = torch.linspace(0, len(names) - 1, min(len(names), options.cameras)).round().int().unique().tolist()
    whole = stored[names[chosen[0]]].size
    height, width = (max(multiple, round(length * side / min(whole) / multiple) * multiple) for length in whole)
    called = short_names([path.parent / path.stem for path in map(PurePosixPath, names)])
    sources = tuple(covering(called[index], stored[names[index]].size, (height, width)) for index in chosen)
    cameras = [view_camera(stored[names[index]], source) for index, source in zip(chosen, sources, strict=True)]
    return Cameras.cat(cameras, dim=1), sources, "stored beside it" if saved.photographed else CHOSEN


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
