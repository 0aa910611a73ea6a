"""Photographs in, an encoded capture out: all that is done once a scene, whatever its styles."""

import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.data.folder import SourceImage, distinct, read_views
from anystyle.geometry.similarity import Similarity
from anystyle.inference import known_cameras, memory, splats
from anystyle.inference.found_cameras import FoundCameras, find_cameras, read_photographs
from anystyle.inference.groups import Capture, Group, encode_groups
from anystyle.inference.options import PoseOptions, SplatOptions, ViewOptions
from anystyle.inference.refine import refine
from anystyle.inference.saved import read_saved
from anystyle.inference.stages import Stages
from anystyle.inference.styles import EmbeddedStyle, slug
from anystyle.methods.branch import Branch
from anystyle.methods.contract import Method, Progress, silent
from anystyle.reconstructions.contract import Reconstruction
from anystyle.reconstructions.feedforward import Feedforward
from anystyle.reconstructions.fit import Fit
from anystyle.reconstructions.sfm.verdict import FEWEST_VIEWS, Verdict
from anystyle.registry.catalog import catalog
from anystyle.stylizer import Stylizer
from anystyle.types import Attributes, Cameras, Gaussians, Geometry, Scene, Views
from anystyle.types.shapes import ShapeError, check_value

_log = logging.getLogger(__name__)

RENDER_CHUNK = 4
"""Views rendered together."""

Inputs = str | Path | Sequence[str | Path] | Views
"""A folder, files, a pattern or a video; or views of one scene."""


@dataclass(frozen=True)
class EncodedCapture:
    """An encoded capture, ready for any number of styles.

    Args:
        stylizer: Encoded it, and restyles and renders it.
        views: The input views, on the CPU; their cameras are those that were known, if any.
        sources: Where each view comes from.
        capture: The encoded groups of views; with known cameras in place of predicted ones where they are used.
        reconstruction: How the scene came to be, for reports.
        targets: Names and cameras of further views to render, in the capture's frame.
        scene_from_known: From the frame of known cameras to the capture's, where they are used.
        splat: The file of the scene, where Gaussians were given.
    """

    stylizer: Stylizer
    views: Views
    sources: tuple[SourceImage, ...]
    capture: Capture
    reconstruction: Mapping[str, object]
    targets: tuple[tuple[str, ...], Cameras] | None = None
    scene_from_known: Similarity | None = None
    splat: Path | None = None

    @property
    def cameras(self) -> Cameras:
        """The cameras of the input views, in the capture's frame."""
        return self.capture.cameras

    @property
    def names(self) -> list[str]:
        """A file name without suffix for each input view."""
        return _file_names([source.name for source in self.sources])

    def unstyled(self) -> Gaussians:
        """The reconstruction itself.

        Raises:
            ValueError: Some of its numbers are NaN or infinite.
        """
        return _finite(self.capture.gaussians(self.stylizer.unstyled), "the unstyled scene")

    def restyle(
        self,
        style: EmbeddedStyle,
        method: Method | None = None,
        on_progress: Callable[[Progress], None] = silent,
    ) -> Gaussians:
        """The scene in a style, by the single pass unless a method is given; groups of views one after the other.

        Raises:
            ValueError: Some of its numbers are NaN or infinite, or the method cannot work on this style.
        """

        def stylized(scene: Scene) -> Gaussians:
            given, embedding = style.style.to(self.stylizer.device), style.embedding
            return (method or Branch())(self.stylizer, scene, given, embedding, on_progress=on_progress)

        return _finite(self.capture.gaussians(stylized), f"the scene in the style {style.title}")

    @torch.no_grad()
    def render(self, gaussians: Gaussians, cameras: Cameras | None = None) -> Iterator[Float[Tensor, "3 H W"]]:
        """Render views one by one, on the CPU; the input views unless cameras are given."""
        cameras = self.cameras if cameras is None else cameras
        for start in range(0, cameras.intrinsics.shape[1], RENDER_CHUNK):
            chunk = cameras.select(slice(start, start + RENDER_CHUNK))
            yield from self.stylizer.render(gaussians, chunk).color[0].cpu()


def encode_capture(
    inputs: Inputs,
    stylizer: Stylizer,
    views: ViewOptions,
    poses: PoseOptions,
    *,
    refined: bool,
    stages: Stages,
    reconstruction: Reconstruction | None = None,
) -> EncodedCapture:
    """Read views and make a scene of them, with cameras as they are asked for.

    Args:
        inputs: What to read, or views that were read already.
        stylizer: In ``eval`` mode, on the device to compute on.
        views: How the views are read and grouped.
        poses: Where cameras come from.
        refined: Whether predicted cameras are aligned by what several views see alike.
        stages: Times the work.
        reconstruction: What becomes of the views; ``None`` fits a scene to them where structure from motion finds their
            cameras, and takes the backbone's elsewhere.

    Raises:
        ValueError: Nothing can be read, memory does not suffice, cameras are not found or do not match, or the
            backbone's outputs are not of the shapes that it promises.
    """
    doubts: dict[str, object] = {}
    if poses.use in ("sfm", "auto") and not isinstance(inputs, Views):
        posed = _find(inputs, stylizer, views, reconstruction, stages, required=poses.use == "sfm")
        if isinstance(posed, FoundCameras):
            return _with_found_cameras(posed, reconstruction, stylizer, stages)
        poses, doubts = replace(poses, use="predicted"), posed.report()
    given, sources = _given(inputs, stylizer, views, reconstruction, stages)
    if reconstruction is not None and reconstruction.needs_cameras:
        return _with_cameras(given, sources, reconstruction, stylizer, poses, refined, stages)
    num_views = len(sources)
    memory.check(stylizer.backbone, min(num_views, views.max_views or num_views), given.size, stylizer.device)
    start = time.perf_counter()
    with stages("encode", f"{num_views} views of {given.size[1]}x{given.size[0]}"):
        capture = encode_groups(
            partial(_encode, stylizer=stylizer, refined=refined, reconstruction=reconstruction),
            Views(given.images, names=given.names).to(stylizer.device),
            size=views.max_views,
            overlap=views.overlap,
        )
        report = reconstruction_report(reconstruction, capture, time.perf_counter() - start) | doubts
        encoded = EncodedCapture(stylizer, given, sources, capture, report)
        return encoded if poses.use in ("predicted", "auto") else _with_known_cameras(encoded, poses)


def encode_splat(
    path: Path, stylizer: Stylizer, views: ViewOptions, options: SplatOptions, *, stages: Stages
) -> EncodedCapture:
    """Read a scene that was saved, look at it from cameras that are stored with it or chosen, and encode what is seen.

    Of a folder of results the unstyled scene is taken.

    Raises:
        ValueError: The file is none of Gaussians, or memory does not suffice.
    """
    start, patch = time.perf_counter(), stylizer.backbone.patch_size
    with stages("read", "the Gaussians"):
        gaussians = read_saved(path, options.up).unstyled.to(stylizer.device)
        cameras, sources, origin = splats.cameras_of(
            path, gaussians, views, options, patch, stylizer.backbone.resolution
        )
        line = splats.check_memory(gaussians.means.shape[1], len(sources), stylizer.device)
    with stages("encode", f"{line}; cameras {origin}"):
        scene = splats.scene_of_splat(gaussians, cameras.to(stylizer.device), stylizer)
    capture = Capture((Group(scene, tuple(range(len(sources))), None, len(sources)),))
    report = reconstruction_report(None, capture, time.perf_counter() - start) | {"kind": "given", "cameras": origin}
    seen = replace(scene.views, names=tuple(source.name for source in sources)).to("cpu")
    return EncodedCapture(
        stylizer, seen, sources, capture, report, splat=path if path.is_file() and options.up == "opencv" else None
    )


def _find(
    inputs: str | Path | Sequence[str | Path],
    stylizer: Stylizer,
    options: ViewOptions,
    reconstruction: Reconstruction | None,
    stages: Stages,
    *,
    required: bool,
) -> FoundCameras | Verdict:
    """Photographs with cameras by structure from motion; why there are none, with a warning, where it goes on so."""
    with stages("read", "the photographs"):
        originals = read_photographs(_paths(inputs), options)
    if len(originals) < FEWEST_VIEWS and not required:
        few = f"{len(originals)} photographs are too few for their cameras to be found, which takes {FEWEST_VIEWS} that"
        return _single_pass(Verdict("failed", (f"{few} overlap",), {}))
    short_side, enlarge = _side(stylizer, options, reconstruction or Fit())
    with stages("cameras", f"of {len(originals)} photographs by structure from motion"):
        posed = find_cameras(
            originals,
            short_side=short_side,
            enlarge=enlarge,
            multiple=stylizer.backbone.patch_size,
            progress=partial(stages.progress, "cameras"),
        )
    if isinstance(posed, FoundCameras):
        if posed.kept:
            stages.note("cameras", "were kept from an earlier run with these photographs")
        for doubt in posed.verdict.reasons:
            _log.warning("cameras: %s", doubt)
        return posed
    reason = "; ".join(posed.reasons)
    if required or (reconstruction is not None and reconstruction.needs_cameras):
        raise ValueError(f"no cameras are found: {reason}; reconstruction=feedforward poses=predicted does without")
    return _single_pass(posed)


def _single_pass(verdict: Verdict) -> Verdict:
    _log.warning(
        "no cameras are found: %s. The scene is what the backbone predicts in a single pass, and nothing confirms it",
        "; ".join(verdict.reasons),
    )
    return verdict


def _with_found_cameras(
    posed: FoundCameras, reconstruction: Reconstruction | None, stylizer: Stylizer, stages: Stages
) -> EncodedCapture:
    start = time.perf_counter()
    trust = posed.verdict.report()
    chosen = reconstruction or Fit()
    if chosen.needs_cameras:
        encoded = _reconstruct(posed.views, posed.sources, chosen, stylizer, stages, posed.points)
        return replace(encoded, reconstruction={**encoded.reconstruction, **trust})
    views = posed.views.to(stylizer.device)
    with stages("encode", f"{len(posed.sources)} views of {views.size[1]}x{views.size[0]}"):
        scene = _encode(views, stylizer, refined=False, reconstruction=chosen)
        group = Group(scene, tuple(range(len(posed.sources))), None, len(posed.sources))
        assert views.cameras is not None
        capture, similarity = known_cameras.with_cameras(Capture((group,)), views.cameras, stylizer.backbone.adapter)
    report = reconstruction_report(chosen, capture, time.perf_counter() - start) | trust
    return EncodedCapture(stylizer, posed.views, posed.sources, capture, report, scene_from_known=similarity)


def _with_cameras(
    views: Views,
    sources: tuple[SourceImage, ...],
    reconstruction: Reconstruction,
    stylizer: Stylizer,
    poses: PoseOptions,
    refined: bool,
    stages: Stages,
) -> EncodedCapture:
    """A scene of views whose cameras are stored or predicted."""
    if poses.use == "known":
        cameras = _known(views, sources, poses).of_all([source.name for source in sources])
    else:
        with stages("encode", f"{len(sources)} views of {views.size[1]}x{views.size[0]}"):
            cameras = _encode(views.to(stylizer.device), stylizer, refined).cameras
    encoded = _reconstruct(replace(views, cameras=cameras.to("cpu")), sources, reconstruction, stylizer, stages)
    return _with_known_cameras(encoded, poses) if poses.use == "target" else encoded


def _reconstruct(
    views: Views,
    sources: tuple[SourceImage, ...],
    reconstruction: Reconstruction,
    stylizer: Stylizer,
    stages: Stages,
    points: Sequence[Tensor] | None = None,
) -> EncodedCapture:
    """A scene of views with cameras, all at once."""
    start, num_views = time.perf_counter(), len(sources)
    with stages("fit", f"a scene to {num_views} views of {views.size[1]}x{views.size[0]}"):
        scene, measures = reconstruction(
            views.to(stylizer.device),
            stylizer.encode if stylizer.branch.gaussian_head is not None else stylizer.encode_colors,
            stylizer.renderer,
            points=points,
            progress=partial(stages.progress, "fit"),
        )
        if measures.get("kept"):
            stages.note("fit", "was kept from an earlier run with these photographs and options")
    capture = Capture((Group(scene, tuple(range(num_views)), None, num_views),))
    report = reconstruction_report(reconstruction, capture, time.perf_counter() - start, measures)
    return EncodedCapture(stylizer, views, sources, capture, report)


def reconstruction_report(
    reconstruction: Reconstruction | None, capture: Capture, seconds: float, measures: Mapping[str, float] | None = None
) -> dict[str, object]:
    """How a scene came to be, for ``report.json``."""
    return {
        "kind": catalog().name_of("reconstruction", type(reconstruction or Feedforward())),
        "registered": capture.cameras.intrinsics.shape[1],
        "seconds": round(seconds, 2),
        **{name: int(value) if value == int(value) else round(value, 4) for name, value in (measures or {}).items()},
    }


def _given(
    inputs: Inputs, stylizer: Stylizer, options: ViewOptions, reconstruction: Reconstruction | None, stages: Stages
) -> tuple[Views, tuple[SourceImage, ...]]:
    if isinstance(inputs, Views):
        return _unchanged(inputs, stylizer.backbone.patch_size)
    short_side, enlarge = _side(stylizer, options, reconstruction)
    with stages("read", "the views"):
        views, sources = read_views(
            _paths(inputs),
            short_side=short_side if options.resize else None,
            enlarge=enlarge,
            multiple=stylizer.backbone.patch_size,
            max_views=options.take,
        )
    return views, tuple(sources)


def _paths(inputs: str | Path | Sequence[str | Path]) -> list[Path]:
    return [Path(path) for path in ([inputs] if isinstance(inputs, (str, Path)) else inputs)]


def _side(stylizer: Stylizer, options: ViewOptions, reconstruction: Reconstruction | None) -> tuple[int, bool]:
    """The short side of views, and whether smaller photographs are enlarged to it.

    They are to what somebody asks for or a network was trained at; a reconstruction gains nothing from it.
    """
    liked = None if reconstruction is None else reconstruction.short_side
    if options.short_side is None and liked is not None:
        return liked, False
    return options.short_side or stylizer.backbone.resolution, True


def _unchanged(views: Views, multiple: int) -> tuple[Views, tuple[SourceImage, ...]]:
    if any(side % multiple for side in views.size):
        raise ValueError(f"the scene's images are {views.size}; their sides must be multiples of {multiple}")
    names = [f"view_{index:02d}" for index in range(views.images.shape[1])]
    return views, tuple(SourceImage.unchanged(name, views.size) for name in names)


def _encode(views: Views, stylizer: Stylizer, refined: bool, reconstruction: Reconstruction | None = None) -> Scene:
    """Encode views in the single pass, and hold what comes of it against the shapes that its types declare."""
    if reconstruction is None:
        scene = stylizer.encode(views)
    else:
        scene = reconstruction(views, stylizer.encode, stylizer.renderer).scene
    batch, number, _, height, width = views.images.shape
    sizes = {"B": batch, "V": number, "H": height, "W": width}
    try:
        check_value(scene.geometry, Geometry, "the backbone's `geometry_head`", **sizes)
        check_value(scene.cameras, Cameras, "the backbone's `geometry_head`", **sizes)
        check_value(scene.attributes, Attributes, "the backbone's `gaussian_head`", **sizes)
    except ShapeError as error:
        raise ValueError(f"{error}; `anystyle plugins check backbone NAME` says all") from error
    return refine(scene, stylizer.backbone.adapter) if refined else scene


def _known(views: Views, sources: tuple[SourceImage, ...], options: PoseOptions) -> known_cameras.KnownCameras:
    """Cameras stored with the views, or beside their files."""
    if sources[0].path is None:
        return known_cameras.from_views(views.cameras, [source.name for source in sources])
    return known_cameras.from_files(sources, None if options.folder is None else Path(options.folder))


def _with_known_cameras(encoded: EncodedCapture, options: PoseOptions) -> EncodedCapture:
    known = _known(encoded.views, encoded.sources, options)
    if options.use == "known":
        cameras = known.of_all([source.name for source in encoded.sources]).to(encoded.stylizer.device)
        capture, similarity = known_cameras.with_cameras(encoded.capture, cameras, encoded.stylizer.backbone.adapter)
        return replace(encoded, capture=capture, scene_from_known=similarity)
    targets, similarity = known.targets_in_scene(encoded.cameras)
    return replace(encoded, targets=(tuple(_file_names(known.names)), targets), scene_from_known=similarity)


def _file_names(names: Sequence[str]) -> list[str]:
    return distinct([slug(name, 80) for name in names], "-")


def _finite(gaussians: Gaussians, what: str) -> Gaussians:
    """The Gaussians themselves, if all their numbers are finite: a scene of NaN is written like any other."""
    for item in fields(gaussians):
        values: Tensor = getattr(gaussians, item.name)
        lost = values.numel() - int(values.isfinite().sum())
        if lost:
            raise ValueError(
                f"{lost} of {values.numel()} numbers of the {item.name} of {what} are NaN or infinite; expected finite "
                "ones. `anystyle plugins check backbone NAME` says where a backbone of your own makes them; trained "
                "weights may need precision=fp32"
            )
    return gaussians
