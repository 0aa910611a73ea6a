"""The third step: views become a scene, once for all styles."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Reconstruction
from anystyle.data.names import distinct
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity
from anystyle.io.splats import NEAR, Offset
from anystyle.methods.colors import colors_alone
from anystyle.pipeline import memory
from anystyle.pipeline.cameras import with_cameras
from anystyle.pipeline.groups import Capture, encode_groups
from anystyle.pipeline.options import ViewOptions
from anystyle.pipeline.read import ReadViews
from anystyle.pipeline.stages import Stages
from anystyle.pipeline.styles import slug
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Scene, SourceImage, Views
from anystyle.types.shapes import ShapeError, check_value

RENDER_CHUNK = 4
"""Views rendered together."""


@dataclass(frozen=True)
class EncodedCapture:
    """An encoded capture, ready for any number of styles.

    Args:
        stylizer: Encoded it, and restyles and renders it.
        views: The input views, on the CPU.
        sources: Where each view comes from.
        capture: The encoded groups of views, in one frame.
        reconstruction: How the scene was made, for reports.
        targets: Names and cameras of further views to render, in the capture's frame.
        scene_from_known: From the frame of stored or estimated cameras to the capture's, where they differ.
        splat: The file of the scene, where Gaussians were given.
        notes: Provenance of the scene, without styles and networks.
        offset: What was taken off the positions of given Gaussians.
    """

    stylizer: Stylizer
    views: Views
    sources: tuple[SourceImage, ...]
    capture: Capture
    reconstruction: Mapping[str, object]
    targets: tuple[tuple[str, ...], Cameras] | None = None
    scene_from_known: Similarity | None = None
    splat: Path | None = None
    notes: tuple[str, ...] = ()
    offset: Offset = NEAR

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the capture's frame."""
        return self.capture.cameras

    @property
    def names(self) -> list[str]:
        """A file name without suffix for each input view."""
        return _file_names([source.name for source in self.sources])

    @torch.no_grad()
    def render(self, gaussians: Gaussians, cameras: Cameras | None = None) -> Iterator[Float[Tensor, "3 H W"]]:
        """Render views one by one, on the CPU; the input views unless cameras are given."""
        cameras = self.cameras if cameras is None else cameras
        for start in range(0, cameras.intrinsics.shape[1], RENDER_CHUNK):
            chunk = cameras.select(slice(start, start + RENDER_CHUNK))
            yield from self.stylizer.render(gaussians, chunk).color[0].cpu()


def encode(given: ReadViews, stylizer: Stylizer, options: ViewOptions, stages: Stages) -> EncodedCapture:
    """Make a scene of views.

    Args:
        given: The views, with cameras where they are known.
        stylizer: In ``eval`` mode, on the device to compute on.
        options: How many views are encoded together.
        stages: Times the work.
    """
    start = time.perf_counter()
    similarity, measures = None, {}
    if given.reconstruction.needs_cameras:
        capture, measures = _fitted(given, stylizer, stages)
    else:
        capture = _single_pass(given, stylizer, options, stages)
        if given.cameras is not None:
            cameras = given.cameras.to(stylizer.device)
            capture, similarity = with_cameras(capture, cameras, stylizer.backbone.adapter)
    targets = None
    if given.targets is not None:
        cameras, similarity = given.targets.targets_in_scene(capture.cameras)
        targets = tuple(_file_names(given.targets.names)), cameras
    kind = catalog().name_of("reconstruction", type(given.reconstruction))
    report = scene_report(kind, capture, time.perf_counter() - start, measures) | dict(given.report)
    return EncodedCapture(stylizer, given.views, given.sources, capture, report, targets, similarity)


def encoder(stylizer: Stylizer) -> Callable[[Views], Scene]:
    """The encoding that the style branch needs of views with cameras; no features if it styles colours alone."""
    if stylizer.branch.gaussian_head is not None:
        return stylizer.encode
    return colors_alone


def _single_pass(given: ReadViews, stylizer: Stylizer, options: ViewOptions, stages: Stages) -> Capture:
    num_views, (height, width) = len(given.sources), given.views.size
    at_once = min(num_views, options.max_views or num_views)
    memory.require_encoding(stylizer.backbone, at_once, given.views.size, stylizer.device)
    with stages("encode", f"{num_views} views of {width}x{height}"):
        return encode_groups(
            partial(_reconstructed, stylizer=stylizer, reconstruction=given.reconstruction),
            Views(given.views.images, names=given.views.names).to(stylizer.device),
            size=options.max_views,
            overlap=options.overlap,
        )


def _fitted(given: ReadViews, stylizer: Stylizer, stages: Stages) -> tuple[Capture, Mapping[str, float]]:
    """All views at once, by a reconstruction that needs their cameras."""
    num_views, (height, width) = len(given.sources), given.views.size
    line = f"{num_views} views of {width}x{height}"
    cameras = given.cameras
    if cameras is None:
        with stages("encode", line):
            cameras = stylizer.encode(given.views.to(stylizer.device)).cameras
    views = replace(given.views.to(stylizer.device), cameras=cameras.to(stylizer.device))
    with stages("fit", f"a scene to {line}") as on_progress:
        scene, measures = given.reconstruction(
            views, encoder(stylizer), stylizer.renderer, points=given.points, on_progress=on_progress
        )
        if measures.get("kept"):
            stages.note("fit", "was read from the cache of an earlier run with these photographs and options")
    return Capture.of(scene), measures


def _reconstructed(views: Views, stylizer: Stylizer, reconstruction: Reconstruction) -> Scene:
    """Encode views in the single pass, and check the result against the shapes that its types declare."""
    scene = reconstruction(views, stylizer.encode, stylizer.renderer).scene
    batch, number, _, height, width = views.images.shape
    sizes = {"B": batch, "V": number, "H": height, "W": width}
    try:
        check_value(scene.geometry, Geometry, "the backbone's `geometry_head`", **sizes)
        check_value(scene.cameras, Cameras, "the backbone's `geometry_head`", **sizes)
        check_value(scene.attributes, Attributes, "the backbone's `gaussian_head`", **sizes)
    except ShapeError as error:
        raise UserError(f"{error}; `anystyle plugins check backbone NAME` checks its whole contract") from error
    return scene


def scene_report(kind: str, capture: Capture, seconds: float, measures: Mapping[str, float]) -> dict[str, object]:
    """How a scene was made, for ``report.json``."""
    return {
        "kind": kind,
        "registered": capture.cameras.intrinsics.shape[1],
        "seconds": round(seconds, 2),
        **{name: int(value) if value == int(value) else round(value, 4) for name, value in measures.items()},
    }


def _file_names(names: list[str] | tuple[str, ...]) -> list[str]:
    return distinct([slug(name, 80) for name in names], "-")
