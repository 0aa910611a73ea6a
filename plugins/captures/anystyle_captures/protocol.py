"""Reconstructions of captures, judged on photographs that they never saw."""

import logging
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from math import isnan, nan
from pathlib import Path
from typing import Any, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor
from torch.nn.functional import interpolate

from anystyle.contracts import Method, Metric, StyleSource, Verdict
from anystyle.contracts.protocol import SCENE, Evaluation, Protocol, Row
from anystyle.data.folder import read_originals, read_views
from anystyle.data.images import read_image
from anystyle.data.photo_masks import masked_views
from anystyle.errors import UserError, listing
from anystyle.evaluation.judge import judge_scene, mean
from anystyle.examples import resolved
from anystyle.io.atomic import atomic_directory, write_json
from anystyle.io.documents import as_number, read_json
from anystyle.io.sheet import to_pil
from anystyle.methods.branch import Branch
from anystyle.paths import expanded
from anystyle.pipeline.cameras import from_files
from anystyle.pipeline.encode import encoder, scene_from_known
from anystyle.pipeline.styles import slug
from anystyle.ranges import AtLeastOne, Count
from anystyle.stylizer import Stylizer
from anystyle.types import Comparison, OnProgress, Progress, Scene, Style, Views, no_progress
from anystyle.vision import lpips
from anystyle.vision.weights import Weights, stand_ins
from anystyle_captures.camera_files.samples import write_wall
from anystyle_captures.fit import Fit, QualityLevel, fit_photographs, for_stereo, scene_of_fit
from anystyle_captures.masks import Masks
from anystyle_captures.median_depth import median_depth
from anystyle_captures.photometric import quality_of
from anystyle_captures.stereo import plane_sweep
from anystyle_captures.structure_from_motion import StructureFromMotion
from anystyle_captures.twins import groups, held_out, to_try
from anystyle_methods.projection import stylized_views
from anystyle_methods.scene_loop import color_map

_log = logging.getLogger(__name__)

BETTER = {"psnr": "higher", "matched_psnr": "higher", "ssim": "higher"}
COMPARED = (
    *(("photographs", kind) for kind in ("unstyled", "palette", "stylized", "view_by_view")),
    ("stylized", "view_by_view"),
    *(("control_photographs", f"control_{kind}") for kind in ("palette", "stylized", "view_by_view")),
)
"""Which kinds of images are compared, the one that should have the better scores first."""
PAINTING = "example:wave"
"""The style in which metrics judge fitted scenes where none is configured."""


class _Result(NamedTuple):
    """Held-out views rendered from a reconstruction, and the reconstruction."""

    renders: Float[Tensor, "V 3 H W"]
    scene: Scene
    num_gaussians: int


class Captures(Protocol):
    """PSNR, SSIM and LPIPS of views held out of each capture, of the backbone's scene and of a fitted one.

    Cameras are estimated from all photographs; neither reconstruction sees the pixels of those held out. The backbone
    gets its own resolution and predicts cameras of its own, among which held-out views are placed by a similarity; the
    fit has the exposure of neighbouring views. ``matched_psnr`` is PSNR after an affine change of each view's colours.
    A capture that cannot be judged is left out, with a warning that is in the provenance, too.
    CPU seconds of the cameras, of each reconstruction and of the metrics are in the provenance,
    under ``costs``; cameras and fits in the cache cost nothing.

    Metrics that are chosen judge all views of each capture, in each style: the ``photographs`` themselves, the
    ``unstyled`` fit, the photographs in the colours of the painting (``palette``), the fit ``stylized``, and the
    photographs painted one by one (``view_by_view``), with the cameras of the fit and the depth by stereo that it
    begins with, where another photograph confirms it. ``photographs over KIND`` is the share of captures and styles in
    which they have the better score, of those where the two differ; ``comparisons`` in the provenance has the numbers
    and names the lost ones.

    Args:
        stylizer: Its backbone predicts, its renderer renders, and its branch restyles.
        method: How fitted scenes take the styles that metrics judge; by default the branch.
        metrics: By name, such as ``consistency``.
        styles: Images; by default one painting of the package.
        captures: Folders of photographs, or videos.
        poses: ``sfm`` estimates cameras; ``known`` takes those stored beside the photographs.
        quality: The quality of the fit; see :class:`~anystyle_captures.fit.Fit`.
        num_gaussians: Instead of the quality's; likewise ``num_steps`` and ``short_side`` of the views in pixels.
        num_steps: See ``num_gaussians``.
        short_side: See ``num_gaussians``.
        holdout: Every ``holdout``-th view is held out.
        take: At most this many photographs, evenly spaced.
        fill_depth: Whether metrics take the fit's median depth where stereo knows none. More pixels are compared, and
            harder ones, so that scores with and without must not be.
        control: Metrics by which all of these are judged again, as ``control_photographs`` and so on, with the unstyled
            fit in place of the photographs.
        lpips_backbone: The network of LPIPS.
        weights: The weights of LPIPS: ``auto`` takes ST-LPIPS (``st_lpips``) or a stand-in where they are missing.

    Raises:
        UserError: There is no capture, or none that can be judged.
    """

    def __init__(
        self,
        *,
        stylizer: Stylizer,
        method: Method | None = None,
        metrics: Mapping[str, Metric] | None = None,
        styles: StyleSource | None = None,
        captures: Sequence[str],
        poses: Literal["sfm", "known"] = "sfm",
        quality: QualityLevel = "good",
        num_gaussians: AtLeastOne | None = None,
        num_steps: AtLeastOne | None = None,
        short_side: AtLeastOne | None = None,
        holdout: Count = 8,
        take: AtLeastOne = 48,
        fill_depth: bool = False,
        control: Sequence[str] = (),
        lpips_backbone: Literal["alex", "vgg"] = "alex",
        weights: Weights = "auto",
    ) -> None:
        if not captures:
            raise UserError("protocol.captures is empty; name folders of photographs or videos")
        self.stylizer, self.captures, self.poses = stylizer, [expanded(path) for path in captures], poses
        self.fit = Fit(quality=quality, num_gaussians=num_gaussians, num_steps=num_steps, holdout=holdout)
        self.short_side, self.take, self.fill_depth = short_side, take, fill_depth
        self.control = {name: one for name, one in (metrics or {}).items() if name in control}
        self.lpips = lpips.load(lpips_backbone, weights)
        self.method, self.metrics, self.styles = method or Branch(), metrics or {}, styles
        self.better = {**BETTER, self.lpips.name: "lower"}
        self.better |= {score: better for metric in self.metrics.values() for score, better in metric.better.items()}

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        write_wall(folder / "wall")
        small = {"num_gaussians": 100, "num_steps": 4, "short_side": 48, "holdout": 4}
        return {"captures": [str(folder / "wall")], "poses": "known", "weights": "stand_in", **small}

    def run(self, out: Path, on_progress: OnProgress) -> Evaluation:
        """Judge each capture; the record of one that is finished is read."""
        records: dict[str, dict[str, Any]] = {}
        left_out: list[str] = []
        rows: list[Row] = []
        for done, path in enumerate(self.captures):
            on_progress(Progress.count("captures", done, len(self.captures)))
            name = path.parent.name if path.name == "images" else path.stem
            folder = out / "captures" / slug(name, 80)
            if not (folder / "record.json").is_file():
                try:
                    with atomic_directory(folder) as temporary:
                        write_json(temporary / "record.json", self._judge(path, temporary))
                except UserError as error:
                    left_out.append(f"{name} is left out: {error}")
                    _log.warning(left_out[-1])
                    continue
            what = f"record of a capture; delete {folder}"
            record: dict[str, Any] = read_json(folder / "record.json", dict[str, Any], what=what)
            judged = {score for scores in record.get("scores", {}).values() for score in scores}
            if lacking := [score for score in self.better if score not in judged]:
                told = f"{folder} was judged without {lacking[0]}, by other metrics or networks or an earlier version"
                raise UserError(f"{told}; delete it")
            records[name] = record
            for kind, values in record["scores"].items():
                scores = numbers(values)
                files = {"photograph": folder / "photograph_0.png", "result": folder / f"{kind}_0.png"}
                rows.append(Row(name, kind, scores, {what: file for what, file in files.items() if file.is_file()}))
        if not records:
            raise UserError(f"no capture can be judged; {'; '.join(left_out)}")
        on_progress(Progress.count("captures", len(self.captures), len(self.captures)))
        kinds = dict.fromkeys(row.style for row in rows)
        groups = {kind: _mean([row.scores for row in rows if row.style == kind]) for kind in kinds}
        found = compared({name: record.get("styles", {}) for name, record in records.items()}, self.better)
        groups |= {title: {name: one["won"] / one["cells"] for name, one in of.items()} for title, of in found.items()}
        for name, record in records.items():
            groups[f"{SCENE}{name}"] = numbers(record["scores"]["fit"] | record["scores"].get("stylized", {}))
            for kind, styles in record.get("styles", {}).items():
                rows += [Row(name, f"{kind}, {style}", numbers(scores)) for style, scores in styles.items()]
        return Evaluation(
            scores=groups["fit"] | groups.get("stylized", {}),
            n=sum(int(record["heldout"]) for record in records.values()),
            better=self.better,
            groups=groups,
            rows=tuple(rows),
            stand_ins=stand_ins([self.lpips.name], self.lpips.source),
            provenance={
                "scenes": list(records),
                "lpips_network": self.lpips.source.stand_in or self.lpips.source.network,
                "costs": {name: record["costs"] for name, record in records.items()},
                "comparisons": found,
                "cameras": {name: record["cameras"] for name, record in records.items()},
                "warnings": left_out + [text for record in records.values() for text in record.get("warnings", [])],
            },
        )

    def _judge(self, path: Path, folder: Path) -> dict[str, Any]:
        start = time.process_time()
        views, points, cameras = self._posed(path)
        costs: dict[str, Any] = {"cameras": {"cpu_seconds": round(time.process_time() - start, 1)}}
        count = views.images.shape[1]
        assert views.cameras is not None
        different = groups(views.images[0], views.cameras, views.names)
        chosen = list(held_out(different, self.fit.holdout, views.cameras))
        if not chosen:
            raise UserError(
                f"{path} has {len(different)} photographs with cameras, and every {self.fit.holdout}th is to be held "
                "out; lower protocol.holdout or give more photographs"
            )
        photographs, masks = views.images[0, chosen], Masks.of(views)
        measured = None if masks is None else masks.select(chosen).measured
        scores: dict[str, Mapping[str, float]] = {}
        styles, warned = dict[str, dict[str, dict[str, float]]](), list[str]()
        fit = partial(self._fit, unseen=to_try(different, chosen, views.cameras))
        for kind, reconstruct in (("fit", fit), ("feedforward", self._feedforward)):
            start = time.process_time()
            try:
                result = reconstruct(views, points, chosen)
            except ValueError as error:
                # A reconstruction that fails, for example with cameras that run the other way, is a result too.
                scores[kind] = dict.fromkeys((*BETTER, self.lpips.name), nan)
                costs[kind] = {"failed": str(error)}
                continue
            spent = round(time.process_time() - start, 1)
            scores[kind] = self._quality(result.renders, photographs, measured)
            costs[kind] = {"cpu_seconds": spent, "num_gaussians": result.num_gaussians}
            if kind == "fit" and self.metrics:
                start = time.process_time()
                judged, styles, warned = self._stylized(views, points, result.scene, path.stem, folder)
                scores |= judged
                costs["metrics"] = {"cpu_seconds": round(time.process_time() - start, 1)}
            for index, render in enumerate(result.renders):
                to_pil(render).save(folder / f"{kind}_{index}.png")
        for index, photograph in enumerate(photographs):
            to_pil(photograph).save(folder / f"photograph_{index}.png")
        cameras["twins"], counts = count - len(different), {"views": count, "heldout": len(chosen)}
        return {"scores": scores, "styles": styles, "costs": costs, "cameras": cameras, "warnings": warned, **counts}

    def _posed(self, path: Path) -> tuple[Views, Sequence[Tensor] | None, dict[str, Any]]:
        """Views with cameras, sparse points where they are known, and the entries of the report on the cameras."""
        multiple, enlarge = self.stylizer.backbone.patch_size, self.short_side is not None
        short_side = self.short_side or self.fit.short_side or self.stylizer.backbone.resolution
        if self.poses == "known":
            read = read_views([path], short_side=short_side, multiple=multiple, max_views=self.take, enlarge=enlarge)
            views, sources, known = from_files(*read)
            if absent := [source.name for index, source in enumerate(sources) if index not in known.indices]:
                told = f"{len(absent)} of {len(sources)} photographs have no stored camera: {listing(absent, 5)}"
                raise UserError(f"{told}; leave them out, or set protocol.poses=sfm")
            views, masks = masked_views(views, sources, {}, empty=True)
            return replace(views, cameras=known.views), None, {"trust": "known", "masks": masks}
        estimator = StructureFromMotion()
        originals = read_originals([path], longest=estimator.longest, max_views=self.take)
        posed = estimator(originals, short_side=short_side, enlarge=enlarge, multiple=multiple, on_progress=no_progress)
        if isinstance(posed, Verdict):
            raise UserError(f"no cameras are found of {path}: {'; '.join(posed.reasons)}")
        registered = f"{len(posed.sources)} of {len(originals)}"
        views, masks = masked_views(posed.views, posed.sources, {}, empty=True)
        return views, posed.points, {**posed.verdict.report(), "registered": registered, "masks": masks}

    @torch.no_grad()
    def _feedforward(self, views: Views, points: Sequence[Tensor] | None, chosen: list[int]) -> _Result:
        """What the backbone predicts from the other views."""
        assert views.cameras is not None
        backbone, device = self.stylizer.backbone, self.stylizer.device
        seen = [view for view in range(views.images.shape[1]) if view not in chosen]
        sides, patch = views.images.shape[-2:], backbone.patch_size
        size = [max(patch, round(side * backbone.resolution / min(sides) / patch) * patch) for side in sides]
        images = interpolate(views.images[0, seen], size=size, mode="bicubic", antialias=True).clamp(0, 1)
        scene = self.stylizer.encode(Views(images[None]).to(device))
        known = views.cameras.to(device)
        similarity = scene_from_known(known.world_from_camera[0, seen], scene.cameras.world_from_camera[0])
        placed = replace(known, world_from_camera=similarity.poses(known.world_from_camera))
        gaussians = self.stylizer.unstyled(scene)
        renders = [self.stylizer.render(gaussians, placed.select([view])).color[0] for view in chosen]
        return _Result(torch.cat(renders).cpu(), scene, int((gaussians.opacities > 0).sum()))

    def _fit(self, views: Views, points: Sequence[Tensor] | None, chosen: list[int], unseen: Sequence[int]) -> _Result:
        """Gaussians fitted to the other views; no step sees those held out."""
        views = views.to(self.stylizer.device)
        assert views.cameras is not None
        count, options = self.fit.amounts(views.images.shape[1])
        masks = Masks.of(views)
        result = fit_photographs(
            views.images[0],
            views.cameras,
            self.stylizer.renderer,
            num_gaussians=count,
            options=replace(options, final_steps=0),
            points=points,
            heldout=chosen,
            unseen=unseen,
            masks=masks,
            keep=True,
        )
        with torch.no_grad():
            exposed = result.photographed(self.stylizer.renderer, views.cameras, chosen, masked=masks is not None)
            scene = scene_of_fit(views, encoder(self.stylizer)(views), result, self.stylizer.renderer)
        return _Result(exposed.cpu(), scene, result.gaussians.means.shape[1])

    @torch.no_grad()
    def _quality(
        self,
        renders: Float[Tensor, "M 3 H W"],
        photographs: Float[Tensor, "M 3 H W"],
        measured: Bool[Tensor, "M H W"] | None,
    ) -> dict[str, float]:
        quality = quality_of(renders, photographs, measured)._asdict()
        if measured is not None:
            renders = torch.where(measured[:, None], renders, photographs)
        distance = self.lpips.compare(self.lpips.describe(renders), self.lpips.describe(photographs))
        return quality | {self.lpips.name: float(distance.mean())}

    def _stylized(
        self, views: Views, points: Sequence[Tensor] | None, scene: Scene, name: str, folder: Path
    ) -> tuple[dict[str, Mapping[str, float]], dict[str, dict[str, dict[str, float]]], list[str]]:
        """Scores of each kind of images along depth by stereo, the same in each style, and warnings."""
        stylizer, device, cameras = self.stylizer, self.stylizer.device, scene.cameras
        styles = [] if self.styles is None else [self.styles.read(index) for index in range(len(self.styles))]
        styles = styles or [Style(image=read_image(resolved(Path(PAINTING)))[None], names=(PAINTING,))]
        views, depth = views.to(device), self._depth(views, scene, points)
        photographs = views.images
        plain = stylizer.render(stylizer.unstyled(scene), cameras).color.detach()
        base = Comparison(photographs, photographs, None, cameras, depth, (name,))
        rows: dict[str, list[Comparison]] = {}
        for style in styles:
            image = None if style.image is None else style.image.to(device)
            embedding = stylizer.embed(text=style.text if image is None else None, image=image)
            gaussians = self.method(stylizer, scene, style.to(device), embedding)
            shown = {"photographs": photographs, "unstyled": plain}
            if image is not None:
                shown["palette"] = color_map(photographs[0], image).of_images(photographs[0])[None]
            shown["stylized"] = stylizer.render(gaussians, cameras).color.detach()
            if stylizer.branch.gaussian_head is None:
                shown["view_by_view"] = stylized_views(stylizer, replace(scene, views=views), embedding)[None]
            for kind, images in shown.items():
                row = replace(base, stylized=images, style=style.to(device), styles=style.names)
                rows.setdefault(kind, []).append(row)
                to_pil(images[0, 0]).save(folder / f"{kind}_0.png")
        sets = [(kind, self.metrics, of_kind) for kind, of_kind in rows.items()]
        if self.control:
            controls = {kind: [replace(row, content=plain) for row in of_kind] for kind, of_kind in rows.items()}
            sets += [(f"control_{kind}", self.control, of_kind) for kind, of_kind in controls.items()]
        scores, warned = dict[str, Mapping[str, float]](), dict[str, None]()
        of_styles: dict[str, dict[str, dict[str, float]]] = {}
        for kind, metrics, of_kind in sets:
            judged = judge_scene(metrics, of_kind).values()
            scores[kind] = {score: value for one in judged for score, value in one.scores.items()}
            warned |= dict.fromkeys(f"{name}, {kind}: {text}" for one in judged for text in one.warned)
            for style, values in ((style, values) for one in judged for style, values in one.styles.items()):
                of_styles.setdefault(kind, {}).setdefault(style, {}).update(values)
        return scores, of_styles, list(warned)

    def _depth(self, views: Views, scene: Scene, points: Sequence[Tensor] | None) -> Float[Tensor, "1 V H W"]:
        """Depth by stereo where another photograph confirms it, elsewhere of the fit if asked for, or else 0."""
        fitted = self.stylizer.unstyled(scene)
        stereo = plane_sweep(*for_stereo(views.images[0], scene.cameras), points=points)
        known = torch.where((stereo.support > 0) & stereo.depth.isfinite(), stereo.depth, 0)[None]
        known = interpolate(known, views.size, mode="nearest-exact").to(fitted.means)
        if not self.fill_depth:
            return known
        return torch.where(known > 0, known, median_depth(fitted, scene.cameras, self.stylizer.renderer))


def _mean(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Over captures with scores; NaN where there are none."""
    return {name: mean([each[name] for each in scores if name in each]) for row in scores for name in row}


def numbers(scores: Mapping[str, Any]) -> dict[str, float]:
    """Scores as they were stored: ``None`` is ``nan``."""
    return {score: as_number(value) for score, value in scores.items()}


def compared(
    captures: Mapping[str, Mapping[str, Mapping[str, Mapping[str, Any]]]], better: Mapping[str, str]
) -> dict[str, dict[str, dict[str, Any]]]:
    """How often one kind of images has the better score than another one, over captures and styles.

    Args:
        captures: Scores by capture, kind and style.
        better: ``higher`` or ``lower`` for each score.

    Returns:
        By ``FIRST over SECOND`` and score, the number of ``cells`` in which the two scores differ, how many the first
        has ``won``, and the names of those that it has ``lost``.
    """
    found: dict[str, dict[str, dict[str, Any]]] = {}
    for (first, second), (score, way) in product(COMPARED, better.items()):
        cells = {
            f"{name} in {style}": (as_number(kinds[first][style].get(score)), as_number(scores.get(score)))
            for name, kinds in captures.items()
            for style, scores in kinds.get(second, {}).items()
        }
        known = {cell: pair for cell, pair in cells.items() if not any(map(isnan, pair)) and pair[0] != pair[1]}
        lost = [cell for cell, (one, other) in known.items() if (one > other) == (way == "lower")]
        if known:
            one = {"cells": len(known), "won": len(known) - len(lost), "lost": lost}
            found.setdefault(f"{first} over {second}", {})[score] = one
    return found
