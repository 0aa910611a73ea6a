"""Reading photographs and videos, with cameras that are stored beside them or estimated."""

import logging
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from anystyle.contracts import Backbone, PosedViews, PoseEstimator, Reconstruction, StoredCamera, Verdict
from anystyle.data.folder import files_of, read_originals, read_views
from anystyle.data.photo_masks import find_masks, masked_views, with_masks
from anystyle.data.poses import unread
from anystyle.errors import UserError
from anystyle.io import video
from anystyle.paths import expanded
from anystyle.pipeline.cameras import stored_beside, with_stored
from anystyle.pipeline.encode import ReadViews
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.provenance import Entry, entry
from anystyle.pipeline.stages import Stages
from anystyle.reconstructions import Feedforward
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.types import SourceImage

_log = logging.getLogger(__name__)


def read_photographs(
    paths: Sequence[Path],
    backbone: Backbone,
    options: ViewOptions,
    poses: PoseOptions,
    reconstruction: Reconstruction | None,
    stages: Stages,
) -> ReadViews:
    """The views of photographs; ``reconstruction`` is the model's, where it names one."""
    masks: Mapping[Path, Path] = {}
    if options.masks is not None:
        masks = find_masks(expanded(options.masks), [path for item in paths for path in files_of(item)])
    estimators, report = catalog().names("pose_estimator"), {}
    stored = _stored_beside(paths, poses) if poses.use == "auto" else None
    if stored:
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
        short_side, enlarge = _view_size(backbone, options, chosen)
        sizes = {"short_side": short_side if options.resize else None, "enlarge": enlarge}
        with stages("read", "the views"):
            most = _max_views(paths, options, chosen)
            views, sources = read_views(paths, **sizes, multiple=backbone.patch_size, max_views=most)
        given = with_stored(ReadViews(views, tuple(sources), chosen, report=report), poses, stored)
    given = replace(given, made_of=_made_of(paths, given.sources))
    return _masked(given, masks, options, stages)


def _stored_beside(paths: Sequence[Path], poses: PoseOptions) -> dict[Path, StoredCamera]:
    """The cameras that are stored beside most photographs, or else none; what is found is logged."""
    files = [file for path in paths for file in files_of(path)]
    try:
        found = stored_beside(files, None if poses.folder is None else Path(poses.folder))
    except UserError as error:
        _log.warning("cameras beside the photographs are not used: %s", error)
        return {}
    if not found:
        if told := unread([*(path for path in paths if path.is_dir()), *(file.parent for file in files)]):
            _log.warning("%s", told)
        return {}
    used = len(found) >= max(2, len(files) / 2)
    told = "used; poses=sfm finds them anew" if used else "not used, for they are too few; poses=known uses them"
    _log.warning("cameras of %d of %d photographs are stored beside them, and are %s", len(found), len(files), told)
    return found if used else {}


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


def _estimated(
    paths: Sequence[Path],
    backbone: Backbone,
    options: ViewOptions,
    reconstruction: Reconstruction,
    estimator: PoseEstimator,
    stages: Stages,
    masks: Mapping[Path, Path],
) -> PosedViews | Verdict:
    short_side, enlarge = _view_size(backbone, options, reconstruction)
    with stages("read", "the photographs"):
        most = _max_views(paths, options, reconstruction)
        longest = max(estimator.longest, 2 * short_side)
        originals = read_originals(paths, longest=longest, max_views=most, panorama=options.panorama)
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


def _view_size(backbone: Backbone, options: ViewOptions, reconstruction: Reconstruction) -> tuple[int, bool]:
    """The shorter side of views in pixels, and whether smaller photographs are enlarged to it.

    They are enlarged to a requested size or the one a network was trained at; a fit gains nothing from enlarged pixels.
    """
    if options.short_side is None and reconstruction.short_side is not None:
        return reconstruction.short_side, False
    return options.short_side or backbone.resolution, True


def _made_of(inputs: Iterable[Path], sources: Sequence[SourceImage]) -> tuple[Entry, ...]:
    """The entry of the photographs and films that views come from."""
    shown, found = {source.path for source in sources}, [file for path in inputs for file in files_of(path)]
    used = [file for file in found if file in shown or file.suffix.lower() in video.SUFFIXES]
    return (entry("photographs", used, views=len(sources)),) if used else ()
