"""The third step: views become a scene, once for all styles.

One pass over all views costs memory and time that grow with them, and a network that was trained on a few dozen gets
worse beyond. Groups of views that overlap keep both bounded: each is encoded by itself and laid into one frame by the
views it shares with the one before.
"""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Adapter, Backbone, Reconstruction
from anystyle.errors import UserError, listing
from anystyle.geometry.transforms import Similarity, similarity_of_cameras
from anystyle.io import limits
from anystyle.io.splats import NEAR, Offset
from anystyle.methods.colors import KEPT, colors_alone, kept_render
from anystyle.paths import distinct, file_name
from anystyle.pipeline.options import ViewOptions
from anystyle.pipeline.provenance import Entry
from anystyle.pipeline.stages import Stages
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Scene, SourceImage, Views
from anystyle.types.shapes import ShapeError, check_value

if TYPE_CHECKING:
    from anystyle.pipeline.cameras import KnownCameras
    from anystyle.pipeline.saved import ReadSplat

_log = logging.getLogger(__name__)
BYTES, BYTES_A_PIXEL = 800, 250
"""Memory that restyling takes: of each Gaussian of degree 3, and of each pixel of the views, with renderer=cpu."""
SEEN = 0.01
"""A camera whose render is less opaque than this, on average over its pixels, sees nothing of the scene."""
PLENTY = 16 * 2**10
"""Bytes per pixel, seven times what the published network takes; where these are free, memory is not estimated."""


@dataclass(frozen=True)
class Group:
    """Some views of a capture, encoded together.

    Args:
        scene: In the group's own frame and unit.
        views: Which views of the capture it shows.
        capture_from_group: From its frame to the capture's, which is the first group's; ``None`` where they are one.
        num_new: How many views at its end no earlier group has; only their Gaussians are used.
    """

    scene: Scene
    views: Sequence[int]
    capture_from_group: Similarity | None
    num_new: int

    @classmethod
    def whole(cls, scene: Scene) -> "tuple[Group]":
        """A capture of one group."""
        num_views = scene.views.images.shape[1]
        return (cls(scene, range(num_views), None, num_views),)

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """The Gaussians that a function gives for this group's new views, in the capture's frame."""
        gaussians = function(self.scene)
        if self.num_new < len(self.views):
            depth, clusters = self.scene.geometry.depth, self.scene.clusters
            first_pixel = depth[0, 0].numel() * (len(self.views) - self.num_new)
            new = torch.arange(gaussians.means.shape[1], device=depth.device) >= first_pixel
            if clusters is not None:
                new = torch.zeros_like(new).index_fill(0, clusters.index[0, first_pixel:], True)
            gaussians = gaussians.map(lambda tensor: tensor[:, new])
        return gaussians if self.capture_from_group is None else self.capture_from_group.gaussians(gaussians)

    def cameras(self) -> Cameras:
        """The cameras of the new views, in the capture's frame."""
        cameras = self.scene.cameras.select(slice(len(self.views) - self.num_new, None))
        if self.capture_from_group is None:
            return cameras
        return replace(cameras, world_from_camera=self.capture_from_group.poses(cameras.world_from_camera[0])[None])


@dataclass(frozen=True)
class ReadViews:
    """The views of a scene as they were read.

    Args:
        views: On the CPU, all of one size.
        sources: Where each view comes from.
        reconstruction: What makes a scene of them.
        cameras: The cameras of all views, stored or estimated; ``None`` where the backbone predicts them.
        points: For each view, sparse points in the cameras' world that it shows, where some are known.
        targets: Stored cameras that the scene is to be rendered from as well.
        report: The entries of ``report.json`` on the cameras.
        made_of: The photographs and films, for the report.
    """

    views: Views
    sources: tuple[SourceImage, ...]
    reconstruction: Reconstruction
    cameras: Cameras | None = None
    points: Sequence[Float[Tensor, "_ 3"]] | None = None
    targets: "KnownCameras | None" = None
    report: Mapping[str, object] = field(default_factory=dict)
    made_of: tuple[Entry, ...] = ()


@dataclass(frozen=True)
class EncodedCapture:
    """An encoded capture, ready for any number of styles.

    Args:
        stylizer: Encoded it, and restyles and renders it.
        views: The input views, on the CPU.
        sources: Where each view comes from.
        groups: The encoded groups of views, in one frame.
        reconstruction: How the scene was made, for reports.
        targets: Names and cameras of further views to render, in the capture's frame.
        scene_from_known: From the frame of stored or estimated cameras to the capture's, where they differ.
        splat: The file of the scene, where Gaussians were given.
        photographed: Whether views are photographs, or those that given Gaussians are known to be of.
        notes: Lines of the file of given Gaussians, such as licences.
        made_of: The photographs, or the file of given Gaussians.
        offset: What was taken off the positions of given Gaussians.
    """

    stylizer: Stylizer
    views: Views
    sources: tuple[SourceImage, ...]
    groups: tuple[Group, ...]
    reconstruction: Mapping[str, object]
    targets: tuple[tuple[str, ...], Cameras] | None = None
    scene_from_known: Similarity | None = None
    splat: Path | None = None
    photographed: bool = True
    notes: tuple[str, ...] = ()
    made_of: tuple[Entry, ...] = ()
    offset: Offset = NEAR

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the capture's frame."""
        return cameras_of(self.groups)

    @property
    def names(self) -> list[str]:
        """A file name without suffix for each input view."""
        return _file_names([source.name for source in self.sources])

    def gaussians(self, function: Callable[[Scene], Gaussians]) -> Gaussians:
        """The Gaussians that a function, such as ``restyle`` with a style, gives for all groups, as one set."""
        return Gaussians.cat([group.gaussians(function) for group in self.groups], dim=1)

    @torch.no_grad()
    def render(self, gaussians: Gaussians, cameras: Cameras | None = None) -> Iterator[Float[Tensor, "3 H W"]]:
        """Render views one by one, on the CPU; the input views unless cameras are given."""
        cameras = self.cameras if cameras is None else cameras
        for camera in (cameras.select([view]) for view in range(cameras.intrinsics.shape[1])):
            kept = kept_render(gaussians, camera, self.stylizer.renderer)
            yield (self.stylizer.render(gaussians, camera).color[0, 0] if kept is None else kept).cpu()


def encode(given: "ReadViews | ReadSplat", stylizer: Stylizer, options: ViewOptions, stages: Stages) -> EncodedCapture:
    """Make a scene of what was read."""
    if not isinstance(given, ReadViews):
        return _encode_splat(given, stylizer, stages)
    start = time.perf_counter()
    similarity, targets, measures = None, None, {}
    if given.reconstruction.needs_cameras:
        groups, measures = _fitted(given, stylizer, stages)
    else:
        groups = _single_pass(given, stylizer, options, stages)
        if given.cameras is not None:
            groups, similarity = with_cameras(groups, given.cameras.to(stylizer.device), stylizer.backbone.adapter)
    if given.targets is not None:
        cameras, similarity = given.targets.targets_in_scene(cameras_of(groups))
        targets = tuple(_file_names(given.targets.names)), cameras
    kind = catalog().name_of("reconstruction", type(given.reconstruction))
    report = _report(kind, len(given.sources), start, measures) | dict(given.report)
    return EncodedCapture(
        stylizer, given.views, given.sources, groups, report, targets, similarity, made_of=given.made_of
    )


def _encode_splat(given: "ReadSplat", stylizer: Stylizer, stages: Stages) -> EncodedCapture:
    """Given Gaussians with the features of their renders."""
    from anystyle.pipeline.saved import splat_scene

    start = time.perf_counter()
    line = require_splat(given.gaussians.means.shape[1], given.cameras, stylizer.device)
    where = "stored beside it" if given.origin == "stored" else "chosen around the scene"
    with stages("encode", f"{line}; cameras {where}"):
        gaussians, cameras = given.gaussians.to(stylizer.device), given.cameras.to(stylizer.device)
        scene = splat_scene(gaussians, cameras, stylizer.renderer, encoder(stylizer))
    _tell_blind(scene.geometry.confidence[0], given.sources)
    return EncodedCapture(
        stylizer,
        replace(scene.views, names=tuple(source.name for source in given.sources)).to("cpu"),
        given.sources,
        Group.whole(scene),
        _report("given", len(given.sources), start, {}) | {"cameras": given.origin},
        splat=given.file,
        photographed=given.origin == "stored",
        notes=given.notes,
        made_of=given.made_of,
        offset=given.offset,
    )


def _tell_blind(alpha: Float[Tensor, "V H W"], sources: Sequence[SourceImage]) -> None:
    """Name the cameras that see hardly anything of a given scene, and refuse where none sees more."""
    blind = [source.name for source, share in zip(sources, alpha.mean((1, 2)).tolist(), strict=True) if share < SEEN]
    remedy = "splat.folder=FOLDER reads cameras of another folder; of an empty one, they are chosen around the scene"
    if len(blind) == len(sources):
        raise UserError(
            f"none of the {len(sources)} cameras sees more than {SEEN:.0%} of the scene: it is faint, or they are of "
            f"another one, or in another frame; {remedy}"
        )
    if blind:
        line = "%d of %d cameras see less than %.0f%% of the scene (%s); %s"
        _log.warning(line, len(blind), len(sources), 100 * SEEN, listing(blind), remedy)


def require_splat(num_gaussians: int, cameras: Cameras, device: torch.device) -> str:
    """Refuse a scene that memory does not hold; a line on what it will take."""
    num_views, (height, width) = cameras.intrinsics.shape[1], cameras.size
    needed = num_gaussians * BYTES + min(num_views * height * width * BYTES_A_PIXEL, KEPT)
    what = f"{num_gaussians:,} Gaussians from {num_views} views"
    if (free := available(device)) is not None:
        limits.require(needed, what, "give a scene of fewer Gaussians, or fewer views with splat.cameras", free)
    return f"{what} take about {needed / 2**30:.2g} GiB"


def encoder(stylizer: Stylizer) -> Callable[[Views], Scene]:
    """The encoding that the style branch needs of views with cameras; no features if it styles colours alone."""
    return colors_alone if stylizer.branch.gaussian_head is None else stylizer.encode


def _single_pass(given: ReadViews, stylizer: Stylizer, options: ViewOptions, stages: Stages) -> tuple[Group, ...]:
    num_views, (height, width) = len(given.sources), given.views.size
    at_once = min(num_views, options.max_views or num_views)
    require_encoding(stylizer.backbone, at_once, given.views.size, stylizer.device)

    def encode(views: Views) -> Scene:
        scene = given.reconstruction(views, stylizer.encode, stylizer.renderer).scene
        sizes = {"B": 1, "V": views.images.shape[1], "H": height, "W": width}
        try:
            check_value(scene.geometry, Geometry, "the backbone's `geometry_head`", **sizes)
            check_value(scene.cameras, Cameras, "the backbone's `geometry_head`", **sizes)
            check_value(scene.attributes, Attributes, "the backbone's `gaussian_head`", **sizes)
        except ShapeError as error:
            raise UserError(f"{error}; `anystyle plugins check backbone NAME` checks its whole contract") from error
        return scene

    with stages("encode", f"{num_views} views of {width}x{height}"):
        cameras = given.cameras if stylizer.backbone.reads_cameras else None
        views = Views(given.views.images, cameras, names=given.views.names).to(stylizer.device)
        return encode_groups(encode, views, size=options.max_views, overlap=options.overlap)


def available(device: torch.device) -> int | None:
    """Free bytes on a device; ``None`` if they are unknown."""
    if device.type == "cuda":
        return int(torch.cuda.mem_get_info(device)[0])
    return limits.free() if device.type == "cpu" else None


def require_encoding(backbone: Backbone, num_views: int, size: tuple[int, int], device: torch.device) -> None:
    """Raise a UserError that says how many views fit if these do not, before anything is computed."""
    free = available(device)
    if free is None or num_views * size[0] * size[1] * PLENTY <= limits.USABLE * free:
        return
    from anystyle.pipeline import memory

    if (estimate := memory.encoding(backbone, size)) is None:
        return
    constant, per_view = estimate
    fits = int((limits.USABLE * free - constant) / per_view) if per_view else 0
    advice = f"{fits} fit: set views.max_views={fits}" if fits >= 2 else "not even two fit: set a smaller size"
    advice += " (groups that overlap), views.short_side or views.take"
    limits.require(constant + per_view * num_views, f"{num_views} views of {size[1]}x{size[0]}", advice, free)


def _fitted(given: ReadViews, stylizer: Stylizer, stages: Stages) -> tuple[tuple[Group, ...], Mapping[str, float]]:
    """All views at once, by a reconstruction that needs their cameras."""
    views, (height, width) = given.views.to(stylizer.device), given.views.size
    line, cameras = f"{len(given.sources)} views of {width}x{height}", given.cameras
    if cameras is None:
        with stages("encode", line):
            cameras = stylizer.encode(views).cameras
    views = replace(views, cameras=cameras.to(stylizer.device))
    with stages("fit", f"a scene to {line}") as on_progress:
        scene, measures = given.reconstruction(
            views, encoder(stylizer), stylizer.renderer, points=given.points, on_progress=on_progress
        )
        if measures.get("kept"):
            stages.note("fit", "was read from the cache of an earlier run with these photographs and options")
    return Group.whole(scene), measures


def _report(kind: str, num_views: int, start: float, measures: Mapping[str, float]) -> dict[str, object]:
    """How a scene was made since ``start``, for ``report.json``."""
    rounded = {name: int(value) if value == int(value) else round(value, 4) for name, value in measures.items()}
    return {"kind": kind, "registered": num_views, "seconds": round(time.perf_counter() - start, 2), **rounded}


def cameras_of(groups: Sequence[Group]) -> Cameras:
    """The cameras of every view, in the capture's frame."""
    return Cameras.cat([group.cameras() for group in groups], dim=1)


def split(num_views: int, size: int, overlap: int) -> list[range]:
    """Consecutive views in groups of ``size`` that overlap by ``overlap``; the last pair may overlap more."""
    if size < 2 or not 1 <= overlap < size:
        raise UserError(
            f"groups of {size} views that share {overlap}; give at least 2 views and fewer shared ones, at least 1"
        )
    last = max(num_views - size, 0)
    return [range(start, min(start + size, num_views)) for start in (*range(0, last, size - overlap), last)]


def encode_groups(
    encode: Callable[[Views], Scene], views: Views, *, size: int | None, overlap: int | None = None
) -> tuple[Group, ...]:
    """Encode a capture in groups of ``size`` views, ``None`` for all at once; neighbours share a quarter by default."""
    num_scenes, num_views = views.images.shape[:2]
    if num_scenes != 1:
        raise UserError(f"{num_scenes} scenes are given; a capture is one")
    if size is None or num_views <= size:
        return Group.whole(encode(views))
    groups: list[Group] = []
    for indices in split(num_views, size, max(1, size // 4) if overlap is None else overlap):
        scene = encode(views.select(list(indices)))
        new = indices[-1] - groups[-1].views[-1] if groups else len(indices)
        groups.append(Group(scene, indices, _capture_from_group(groups[-1], scene, indices) if groups else None, new))
    return tuple(groups)


def _capture_from_group(last: Group, scene: Scene, indices: Sequence[int]) -> Similarity:
    """From a new group's frame to the capture's, by the views it shares with the one before.

    The unit is what their depths say, pixel by pixel, for the positions of few cameras say little of it.
    """
    num_shared = last.views[-1] + 1 - indices[0]
    target = last.scene.cameras.world_from_camera[0, -num_shared:]
    source = scene.cameras.world_from_camera[0, :num_shared]
    ratio = last.scene.geometry.depth[0, -num_shared:] / scene.geometry.depth[0, :num_shared].clamp_min(1e-12)
    scale = ratio.flatten().median()
    rotation = similarity_of_cameras(source, target).rotation
    translation = (target[:, :3, 3] - scale * source[:, :3, 3] @ rotation.mT).mean(0)
    last_from_group = Similarity(scale, rotation, translation)
    return last_from_group if last.capture_from_group is None else last.capture_from_group.after(last_from_group)


def scene_from_known(known: Float[Tensor, "V 4 4"], predicted: Float[Tensor, "V 4 4"]) -> Similarity:
    """The similarity from the frame of known cameras to that of predicted ones, all of them world from camera."""
    similarity = similarity_of_cameras(known, predicted)
    if not bool(similarity.scale > 0):
        raise UserError(
            "the cameras that are stored, or were found, do not match the images as the backbone sees them: they move "
            "the other way; check that stored ones are in the images' order, or use poses=predicted"
        )
    return similarity


def with_cameras(groups: Sequence[Group], cameras: Cameras, adapter: Adapter) -> tuple[tuple[Group, ...], Similarity]:
    """Groups with their predicted cameras replaced by known ones, and the similarity from their frame to the capture's.

    Depth and Gaussians keep the unit that the network predicts in; the known cameras are brought there by the
    similarity that fits the predicted ones best.
    """
    placed, similarities = [], []
    for group in groups:
        known = cameras.select(list(group.views))
        group_from_known = scene_from_known(known.world_from_camera[0], group.scene.cameras.world_from_camera[0])
        similarities.append(group_from_known)
        known = replace(known, world_from_camera=group_from_known.poses(known.world_from_camera))
        geometry = group.scene.geometry.seen_from(known)
        clusters = adapter.cluster(geometry, group.scene.attributes)
        capture_from_group = similarities[0].after(group_from_known.inverse()) if placed else None
        scene = replace(group.scene, geometry=geometry, clusters=clusters)
        placed.append(replace(group, scene=scene, capture_from_group=capture_from_group))
    return tuple(placed), similarities[0]


def _file_names(names: Sequence[str]) -> list[str]:
    return distinct([file_name(name) for name in names], "-")
