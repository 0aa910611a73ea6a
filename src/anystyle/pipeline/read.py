"""The second step: photographs, a video, views or a saved scene, as views of one size with the cameras asked for."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from jaxtyping import Float
from omegaconf import DictConfig
from torch import Tensor

from anystyle.contracts import Backbone, PosedViews, PoseEstimator, Reconstruction, Verdict
from anystyle.data.folder import covering, files_of, read_originals, read_views
from anystyle.data.images import listing
from anystyle.data.photo_masks import find_masks, masked_views, with_masks
from anystyle.errors import UserError
from anystyle.io import video
from anystyle.paths import expanded
from anystyle.pipeline.cameras import KnownCameras, from_files, from_views, stored_beside
from anystyle.pipeline.inputs import InMemory, Photographs, SavedScene
from anystyle.pipeline.load import LoadedModel, make_scenes
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.provenance import Entry, photographs
from anystyle.pipeline.request import Request
from anystyle.pipeline.stages import Stages
from anystyle.reconstructions import Feedforward
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, SourceImage, Views

if TYPE_CHECKING:
    from anystyle.pipeline.saved import ReadSplat

_log = logging.getLogger(__name__)


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
    targets: KnownCameras | None = None
    report: Mapping[str, object] = field(default_factory=dict)
    made_of: tuple[Entry, ...] = ()


def read(request: Request, model: LoadedModel, stages: Stages) -> "ReadViews | ReadSplat":
    """Read the inputs of a request, with cameras where they are known or can be estimated.

    Where the model names no reconstruction, the plugin that estimates cameras chooses it if it succeeds; elsewhere it
    is the backbone's single pass.
    """
    backbone, options, inputs = model.stylizer.backbone, request.views, request.inputs
    poses = PoseOptions(request.poses.use or model.poses, request.poses.folder)
    if options.masks is not None and not isinstance(inputs, Photographs):
        given = inputs.path if isinstance(inputs, SavedScene) else "views"
        raise UserError(f"views.masks={options.masks}: masks belong to photographs, and the input is {given}")
    match inputs:
        case SavedScene(path):
            from anystyle.pipeline.saved import read_splat

            return read_splat(path, model.stylizer, options, request.splat, stages)
        case Photographs(paths):
            return _photographs(paths, backbone, options, poses, model.reconstruction, stages)
        case InMemory(views):
            return _in_memory(views, backbone, poses, model.reconstruction)
        case None:
            views = first_views(request.config, options)
            return _in_memory(views, backbone, poses, model.reconstruction)


def first_views(config: DictConfig, options: ViewOptions) -> Views:
    """The first views of the configured scene."""
    source = make_scenes(config)
    if not 0 <= config.scene < len(source):
        raise UserError(f"scene={config.scene} does not exist; the source holds {len(source)}")
    number = min(source.num_views(config.scene), options.take or Reconstruction.max_views)
    return source.read(config.scene, range(number))


def _in_memory(
    views: Views, backbone: Backbone, poses: PoseOptions, reconstruction: Reconstruction | None
) -> ReadViews:
    if any(side % backbone.patch_size for side in views.size):
        wrong = f"the scene's images are {views.size}"
        raise UserError(f"{wrong}; their sides must be multiples of {backbone.patch_size}")
    names = [f"view_{index:02d}" for index in range(views.images.shape[1])]
    sources = tuple(covering(name, views.size, views.size) for name in names)
    return _with_stored(views, sources, reconstruction or Feedforward(), poses)


def _photographs(
    paths: Sequence[Path],
    backbone: Backbone,
    options: ViewOptions,
    poses: PoseOptions,
    reconstruction: Reconstruction | None,
    stages: Stages,
) -> ReadViews:
    masks: Mapping[Path, Path] = {}
    if options.masks is not None:
        masks = find_masks(expanded(options.masks), [path for item in paths for path in files_of(item)])
    estimators, report = catalog().names("pose_estimator"), {}
    if poses.use == "auto" and _stored_beside(paths, poses):
        poses = replace(poses, use="known")
        if reconstruction is None and estimators:
            reconstruction = build(Reconstruction, build(PoseEstimator, estimators[0]).reconstruction)
    estimator = next(iter(estimators), None) if poses.use == "auto" else poses.use
    given: ReadViews | None = None
    if estimator in estimators:
        estimate = build(PoseEstimator, estimator)
        chosen = reconstruction or build(Reconstruction, estimate.reconstruction)
        posed = _estimated(paths, backbone, options, chosen, estimate, stages, masks)
        if isinstance(posed, PosedViews):
            report = posed.verdict.report()
            given = ReadViews(posed.views, posed.sources, chosen, posed.views.cameras, posed.points, report=report)
        else:
            reason, report = "; ".join(posed.reasons), posed.report()
            if poses.use != "auto" or (reconstruction is not None and reconstruction.needs_cameras):
                remedy = "reconstruction=feedforward poses=predicted does without"
                raise UserError(f"no cameras are found: {reason}; {remedy}")
            _log.warning(
                "no cameras are found: %s. The scene is what the backbone predicts in a single pass, and nothing "
                "confirms it",
                reason,
            )
    if given is None:
        chosen = reconstruction or Feedforward()
        short_side, enlarge = view_size(backbone, options, chosen)
        with stages("read", "the views"):
            views, sources = read_views(
                paths,
                short_side=short_side if options.resize else None,
                enlarge=enlarge,
                multiple=backbone.patch_size,
                max_views=_max_views(paths, options, chosen),
            )
        given = replace(_with_stored(views, tuple(sources), chosen, poses), report=report)
    given = replace(given, made_of=photographs(paths, given.sources))
    return _masked(given, masks, options, stages)


def _stored_beside(paths: Sequence[Path], poses: PoseOptions) -> bool:
    """Whether cameras of most photographs are stored beside them; what is found is logged."""
    files = [file for path in paths for file in files_of(path)]
    try:
        found = stored_beside(files, None if poses.folder is None else Path(poses.folder))
    except UserError as error:
        _log.warning("cameras beside the photographs are not used: %s", error)
        return False
    if not found:
        return False
    used = len(found) >= max(2, len(files) / 2)
    _log.warning(
        "cameras of %d of %d photographs are stored beside them, and are %s",
        len(found),
        len(files),
        "used; poses=sfm finds them anew" if used else "not used, for they are too few; poses=known uses them",
    )
    return used


def _masked(given: ReadViews, masks: Mapping[Path, Path], options: ViewOptions, stages: Stages) -> ReadViews:
    views, report = masked_views(given.views, given.sources, masks, empty=options.masked == "empty")
    if report:
        stages.note(
            "masks",
            f"of {report['photographs']} of {len(given.sources)} photographs: {report['transparent']:.0%} of the "
            f"pixels are empty, {report['ignored']:.0%} are ignored",
        )
    if not given.reconstruction.needs_cameras and (report or views.valid is not None):
        _log.warning(
            "the single pass knows no masks: what is transparent is white in it, and what masks ignore is in the "
            "scene; reconstruction=fit builds neither"
        )
    return replace(given, views=views, report={**given.report, **({"masks": report} if report else {})})


def _with_stored(
    views: Views, sources: tuple[SourceImage, ...], reconstruction: Reconstruction, poses: PoseOptions
) -> ReadViews:
    """Views with the cameras that are stored for them, where these are asked for."""
    if poses.use not in ("known", "target"):
        return ReadViews(views, sources, reconstruction)
    names = [source.name for source in sources]
    if sources[0].path is None:
        known = from_views(views.cameras, names)
    else:
        views, sources, known = from_files(views, sources, None if poses.folder is None else Path(poses.folder))
    if poses.use == "target":
        return ReadViews(views, sources, reconstruction, targets=known)
    if without := [name for index, name in enumerate(names) if index not in known.indices]:
        told = "%d of %d photographs have no stored camera and are left out: %s"
        _log.warning(told, len(without), len(names), listing(without))
    kept = list(known.indices)
    return ReadViews(views.select(kept), tuple(sources[index] for index in kept), reconstruction, known.views)


def _estimated(
    paths: Sequence[Path],
    backbone: Backbone,
    options: ViewOptions,
    reconstruction: Reconstruction,
    estimator: PoseEstimator,
    stages: Stages,
    masks: Mapping[Path, Path],
) -> PosedViews | Verdict:
    short_side, enlarge = view_size(backbone, options, reconstruction)
    with stages("read", "the photographs"):
        most = _max_views(paths, options, reconstruction)
        originals = read_originals(paths, longest=max(estimator.longest, 2 * short_side), max_views=most)
        originals = with_masks(originals, masks)
    if len(originals) < estimator.min_views:
        few = f"{len(originals)} photographs are too few for their cameras to be found"
        return Verdict("failed", (f"{few}, which takes {estimator.min_views} that overlap",), {})
    with stages("cameras", f"of {len(originals)} photographs") as on_progress:
        posed = estimator(
            originals, short_side=short_side, enlarge=enlarge, multiple=backbone.patch_size, on_progress=on_progress
        )
    if isinstance(posed, PosedViews):
        if posed.cached:
            stages.note("cameras", "were read from the cache of an earlier run with these photographs")
        for doubt in posed.verdict.reasons:
            _log.warning("cameras: %s", doubt)
    return posed


def _max_views(paths: Sequence[Path], options: ViewOptions, reconstruction: Reconstruction) -> int:
    """How many photographs are read at most. Of a video, whose neighbouring frames show much the same, fewer are."""
    videos = any(path.suffix.lower() in video.SUFFIXES for path in paths)
    return options.take or (Reconstruction.max_views if videos else reconstruction.max_views)


def view_size(backbone: Backbone, options: ViewOptions, reconstruction: Reconstruction) -> tuple[int, bool]:
    """The shorter side of views in pixels, and whether smaller photographs are enlarged to it.

    They are enlarged to a requested size or the one a network was trained at; a fit gains nothing from enlarged pixels.
    """
    if options.short_side is None and reconstruction.short_side is not None:
        return reconstruction.short_side, False
    return options.short_side or backbone.resolution, True
