"""The judge: every method's figures, cell by cell, and their means with intervals.

Figures are cached in ``RESULTS/.judged`` by the hashes of the images: only what changed is computed again. Figures of
a single style belong to its cell; those of all styles of a scene, such as a distance of distributions, to the scene.
"""

import hashlib
import logging
import math
import multiprocessing
import signal
import sys
import warnings
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
import torch
from jaxtyping import Float
from msgspec import Struct
from PIL import Image, ImageOps
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.data.images import open_image
from anystyle.errors import UserError, check_known, one_line
from anystyle.evaluation import judge as loop
from anystyle.evaluation.comparisons import Reader, read
from anystyle.evaluation.pairing import CAMERAS, StylizedImages
from anystyle.evaluation.run import make_metrics
from anystyle.io.arrays import read_arrays
from anystyle.io.atomic import atomic_path, write_json
from anystyle.io.documents import Number, as_number, kept_json, read_json, stored_number
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.registry.schema import runtime_arguments
from anystyle.types import Comparison, OnProgress, Progress, Style
from anystyle.vision import weights
from anystyle_benchmark.results import (
    Cell,
    CellFigures,
    Figures,
    Lock,
    MetricInfo,
    Origin,
    Record,
    SceneFigures,
    TableRow,
    digest,
    read_lock,
    wrong_images,
)
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.statistics import arranged, interval, rounded
from anystyle_benchmark.track import PROTOCOL, TRACKS, Inputs, SceneEntry, StyleEntry

log = logging.getLogger(__name__)

GUIDES = ("image", "text")
ENCODERS, STAND_IN = (("clip", "clip_b32"), ("long_clip", "longclip_b32")), ("tiny", "tiny_style_encoder")
"""Style encoders for texts, with their weights: the first that is installed, or else the stand-in."""
DEPTH = "depth.npz"
"""The file of a track's depth along z, an array ``[H, W]`` at the judged size for each view; 0 where it is unknown."""
PHOTOGRAPHS = ".photographs"
"""The folder of what images are compared with, ``SCENE/VIEW.png``, in the folder of results."""


class Judged(Struct, frozen=True):
    """A metric's figures of each style and of all of a scene; ``key`` hashes what they were computed from."""

    key: str
    styles: dict[str, dict[str, Number]]
    scene: dict[str, Number]


class Unit(NamedTuple):
    """What is judged at once: a method's images of a scene in all styles of a guide."""

    method: str
    seed: int
    scene: str
    guide: str


class Found(NamedTuple):
    """The cells of a unit, the figures of its styles together, what made the images, and lines to be told."""

    rows: list[CellFigures]
    scene: dict[str, Number]
    origins: dict[str, Origin]
    lines: list[str]


class Judge:
    """Judges the methods in a folder of results by a track's metrics, all or those that are ``chosen``.

    Args:
        processes: How many judge at once, each with one thread; with 1, this one does.
    """

    def __init__(self, inputs: Inputs, root: Path, chosen: Sequence[str] = (), *, processes: int = 1) -> None:
        self.inputs, self.root, self.processes, track = inputs, root, processes, inputs.track
        named = list(dict.fromkeys(name for guide in GUIDES for name in track.metrics.get(guide, ())))
        check_known(f"metric of track {track.name}", chosen, named)
        images = [read(inputs.path(style.image)) for style in track.styles if style.image is not None]
        self.metrics = make([name for name in named if name in (chosen or named)], images)
        self.chosen, self._reader = tuple(chosen), Reader()

    def __call__(self, specs: Sequence[Spec], lock: Lock, on_progress: OnProgress) -> Figures:
        """The figures of these methods; ``on_progress`` is called for every scene of each."""
        units = [
            Unit(spec.name, seed, scene.name, guide)
            for spec in specs
            for seed in range(spec.seeds if spec.not_run is None else 0)
            if seed == 0 or (self.root / spec.name / str(seed)).is_dir()
            for scene in self.inputs.track.scenes
            for guide in GUIDES
            if guide in spec.guides and self._styles(guide)
        ]
        scenes = [scene.name for scene in self.inputs.track.scenes]
        rows: dict[Unit, list[CellFigures]] = {}
        wholes: dict[Unit, dict[str, Number]] = {}
        origins, said = dict[str, Origin](), set[str]()
        in_order = sorted(units, key=lambda unit: scenes.index(unit.scene))  # features of its photographs are kept
        on_progress(Progress.count("judge", 0, len(units)))
        for unit, found in zip(in_order, self._all(in_order), strict=True):
            rows[unit], wholes[unit] = found.rows, found.scene
            origins |= found.origins
            for line in found.lines:
                if line not in said:
                    log.warning(line)
                said.add(line)
            on_progress(Progress.count("judge", len(rows), len(units)))
        together = {name for unit in units for name in _together(rows[unit], wholes[unit])}
        cells = [
            msgspec.structs.replace(row, figures={n: row.figures[n] for n in row.figures if n not in together})
            for unit in units
            for row in rows[unit]
        ]
        of_scenes = [SceneFigures(*unit, {n: wholes[unit][n] for n in wholes[unit] if n in together}) for unit in units]
        of_scenes = [one for one in of_scenes if one.figures]
        table = [_row(spec.name, guide, list(self.infos), cells, of_scenes) for spec in specs for guide in spec.guides]
        methods = {spec.name: spec for spec in specs}
        shown = [row for row in table if row.cells]
        return Figures(lock, self.infos, methods, cells, of_scenes, shown, dict(sorted(origins.items())))

    @cached_property
    def infos(self) -> dict[str, MetricInfo]:
        """The columns of the table."""
        infos: dict[str, MetricInfo] = {}
        for name, metric in self.metrics.items():
            reference = (sys.modules[type(metric).__module__].__doc__ or "").partition("\n")[0]
            for figure, better in metric.better.items():
                stand_in = metric.stand_ins.get(figure, "")
                title = figure.replace("_", " ")
                infos[figure] = MetricInfo(title, better, reference, stand_in, name, dict(metric.weights))
        return infos

    def _all(self, units: Sequence[Unit]) -> Iterator[Found]:
        """What is found of each unit, in their order."""
        if self.processes == 1:
            yield from map(self.judge, units)
            return
        job = self.inputs, self.root, self.chosen
        pool = ProcessPoolExecutor(self.processes, multiprocessing.get_context("spawn"), _begin, job)
        try:
            yield from pool.map(_judge, units)
        finally:
            pool.shutdown(cancel_futures=True)  # after the units that are being judged, whose figures are kept

    def _styles(self, guide: str) -> list[StyleEntry]:
        return [style for style in self.inputs.track.styles if style.guide == guide]

    def judge(self, unit: Unit) -> Found:
        """The cells of a unit with their figures, and those of the scene; a cell of bad images has failed."""
        scene, rows, images, origins, lines = self.inputs.scene(unit.scene), [], {}, {}, []
        size = self.inputs.size(scene)
        for style in self._styles(unit.guide):
            cell = Cell(unit.method, unit.seed, unit.scene, style.name)
            record = kept_json(cell.record(self.root), Record) or Record("missing")
            status, message = record.status, record.message
            if status == "done" and (wrong := wrong_images(cell.images(self.root), scene.views, size)):
                status, message = "failed", wrong[0]
            elif status == "done":
                files = [cell.images(self.root) / f"{view}.png" for view in scene.views]
                images[style.name] = digest([hashlib.sha256(path.read_bytes()).hexdigest() for path in files])
            taken = record.seconds, record.scene_seconds, record.memory
            origins[record.origin.key] = record.origin
            made = {"images": images.get(style.name, ""), "origin": record.origin.key}
            rows.append(CellFigures(*cell, unit.guide, status, message, *taken, **made))
        judged = self._figures(unit, images, lines) if images else []
        for row in rows:
            for one in judged:
                row.figures.update(one.styles.get(row.style, {}))
        return Found(rows, {name: figure for one in judged for name, figure in one.scene.items()}, origins, lines)

    def _figures(self, unit: Unit, images: Mapping[str, str], lines: list[str]) -> list[Judged]:
        """The figures of a unit's whole images, by every metric of its guide: those kept, and those that are new."""
        file = self.root / ".judged" / unit.method / str(unit.seed) / unit.scene / f"{unit.guide}.json"
        kept: dict[str, Judged] = kept_json(file, dict[str, Judged]) or {}
        names = [name for name in self.inputs.track.metrics.get(unit.guide, ()) if name in self.metrics]
        keys = {
            name: digest([PROTOCOL, name, *metric.better, sorted(metric.weights.items()), sorted(images.items())])
            for name, metric in self.metrics.items()
            if name in names
        }
        missing = [name for name in names if name not in kept or kept[name].key != keys[name]]
        kept = {name: judged for name, judged in kept.items() if name not in missing}
        for name, new in self._new(missing, unit, list(images), lines).items():
            styles = {style: _rounded(figures) for style, figures in new.styles.items()}
            kept[name] = Judged(keys[name], styles, _rounded(new.scores))
        if missing:
            write_json(file, msgspec.to_builtins(kept))
        return [kept[name] for name in names if name in kept]

    def _new(
        self, names: Sequence[str], unit: Unit, styles: Sequence[str], lines: list[str]
    ) -> dict[str, loop.SceneScores]:
        """The metric loop; metrics that raise are left out and told."""
        scene = self.inputs.scene(unit.scene)
        why = "" if scene.geometry else " (the track has no geometry of this scene)"

        def on_error(name: str, error: Exception) -> None:
            lines.append(f"{name} has no figures in {scene.name}: {one_line(error)}{why}")

        torch.manual_seed(0)
        try:
            metrics = {name: self.metrics[name] for name in names}
            return loop.judge_scene(metrics, self._comparisons(unit, styles), on_error) if metrics else {}
        except ValueError as error:  # of files that cannot be compared
            lines.append(f"{unit.method} has no figures in {scene.name}: {one_line(error)}")
            return {}

    def _comparisons(self, unit: Unit, styles: Sequence[str]) -> Iterator[Comparison]:
        scene = self.inputs.scene(unit.scene)
        content = photographs(self.inputs, scene, self.root)
        geometry = None if scene.geometry is None else self.inputs.path(scene.geometry)
        depth = None if geometry is None else _depth(geometry / DEPTH, scene.views)
        for style in map(self.inputs.style, styles):
            folder = Cell(unit.method, unit.seed, unit.scene, style.name).images(self.root)
            comparison = self._reader(
                StylizedImages(
                    scene=scene.name,
                    style=style.name,
                    frames=scene.views,
                    content=content,
                    stylized=tuple(folder / f"{view}.png" for view in scene.views),
                    # A text has no picture: the reader's is put aside below.
                    reference=content[0] if style.image is None else self.inputs.path(style.image),
                    cameras=None if geometry is None else geometry / CAMERAS,
                )
            )
            if style.text is not None:
                comparison = replace(comparison, style=Style(text=(style.text,), names=(style.name,)))
            yield replace(comparison, depth=depth)


_worker: Judge
"""The judge of a process that judges for another."""


def _begin(inputs: Inputs, root: Path, chosen: Sequence[str]) -> None:
    global _worker
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the terminal sends it to all, and the first one ends the others
    torch.set_num_threads(1)
    logging.disable(logging.WARNING)  # which networks stand in, the first process has told
    _worker = Judge(inputs, root, chosen)
    logging.disable(logging.NOTSET)


def _judge(unit: Unit) -> Found:
    return _worker.judge(unit)


def make(names: Sequence[str], gallery: Sequence[Tensor]) -> dict[str, Metric]:
    """Metrics as they were meant, with correspondences from depth; ``gallery``: style images to be told apart."""
    encoder, file = next(
        (pair for pair in ENCODERS if any(path.is_file() for path in weights.candidates(pair[1]))), STAND_IN
    )
    source = replace(
        weights.published(file, weights.find(file)), stand_in=encoder if (encoder, file) == STAND_IN else ""
    )
    words = ["subject=images", "protocol=folders", "variant=corrected", "correspondence=rendered_depth"]
    words += [f"metric=[{','.join(names)}]", f"style_encoder={encoder}", f"weights.style_encoder={file}"]
    with warnings.catch_warnings(action="ignore"):  # of networks that stand in, which the table names
        metrics = make_metrics(compose("evaluate", words), None, torch.device("cpu"))
    for name, metric in metrics.items():
        metric.gallery = gallery
        if "style_encoder" in runtime_arguments(catalog().find("metric", name)):
            metric.weights = {**metric.weights, **weights.checksums(source)}
            metric.stand_ins = {**metric.stand_ins, **weights.stand_ins(metric.better, source)}
    return metrics


def photographs(inputs: Inputs, scene: SceneEntry, root: Path) -> tuple[Path, ...]:
    """What images of a scene are compared with: its photographs in their size, made once in the folder of results."""
    files, (height, width) = inputs.photographs(scene), inputs.size(scene)
    made = {view: root / PHOTOGRAPHS / scene.name / f"{view}.png" for view in scene.views}
    for view, path in made.items():
        if not path.is_file():
            with atomic_path(path) as temporary:
                ImageOps.fit(open_image(files[view]), (width, height), Image.Resampling.LANCZOS).save(temporary)
    return tuple(made.values())


def _depth(file: Path, views: Sequence[str]) -> Float[Tensor, "1 V H W"]:
    maps = read_arrays(file, views, what="file of depth maps by view")
    return torch.from_numpy(np.stack([maps[view] for view in views]))[None].float()


def inputs_of(root: Path, track: str | None = None, folder: Path | None = None) -> Inputs:
    """The track of a folder of results: that of a name or file, or the one that the results name."""
    name = track or read_lock(root).name
    if not track and not (TRACKS / name).is_dir():
        raise UserError(f"{root} is of track {name}, which is a file of yours; name it: --track FILE.toml")
    return Inputs(name, folder)


def read_methods(root: Path) -> list[Spec]:
    """The specs of the methods in a folder of results, by name."""
    specs = {path: read_json(path, Spec, what="spec of a method") for path in sorted(root.glob("*/method.json"))}
    for path, spec in specs.items():
        if spec.name != path.parent.name:
            raise UserError(f"{path} is the spec of {spec.name}; a method lies in the folder of its name")
    if not specs:
        raise UserError(f"{root} holds no results of a method (METHOD/method.json); anystyle benchmark run makes some")
    return list(specs.values())


def wrong(inputs: Inputs, folder: Path) -> list[str]:
    """What is wrong with somebody's images ``SCENE/STYLE/VIEW.png`` of a track, a line each.

    A guide of which there is no style at all is one that the method does not follow.
    """
    if not folder.is_dir():
        raise UserError(f"there is no folder {folder}")
    track, lines = inputs.track, []
    known = {"scene": {scene.name for scene in track.scenes}, "style": {style.name for style in track.styles}}
    for what, pattern in (("scene", "[!.]*"), ("style", "[!.]*/[!.]*")):
        others = [path for path in sorted(folder.glob(pattern)) if path.is_dir() and path.name not in known[what]]
        lines += [f"{path.relative_to(folder)}: the track has no such {what}" for path in others]
    cells = [(scene, style, folder / scene.name / style.name) for scene in track.scenes for style in track.styles]
    guides = {style.guide for _, style, images in cells if images.is_dir()}
    for scene, style, images in cells:
        if style.guide in guides and not images.is_dir():
            lines.append(f"{scene.name}: there is no {style.name}")
        elif style.guide in guides:
            lines += [f"{scene.name}: {line}" for line in wrong_images(images, scene.views, inputs.size(scene))]
    return lines if guides else [*lines, "there are no images of any scene and style of the track"]


def _row(
    method: str, guide: str, figures: Sequence[str], cells: Sequence[CellFigures], wholes: Sequence[SceneFigures]
) -> TableRow:
    rows = [row for row in (*cells, *wholes) if (row.method, row.guide) == (method, guide)]
    states = [row.status for row in rows if isinstance(row, CellFigures)]
    values = {figure: arranged(figure, rows)[0] for figure in figures}
    means = {figure: interval(value) for figure, value in values.items() if value.size}
    return TableRow(method, guide, len(states), len(states) - states.count("done"), means)


def _together(rows: Sequence[CellFigures], scene: Mapping[str, Number]) -> list[str]:
    """The figures of a scene that are not the mean of the single styles' figures."""
    done = [row.figures for row in rows if row.status == "done"]
    alone = {name: loop.mean([as_number(figures.get(name)) for figures in done]) for name in scene}
    return [
        name
        for name, whole in ((name, as_number(figure)) for name, figure in scene.items())
        if len(done) > 1 and not math.isnan(whole) and not math.isclose(alone[name], whole, rel_tol=1e-4, abs_tol=1e-6)
    ]


def _rounded(figures: Mapping[str, float]) -> dict[str, Number]:
    return {name: stored_number(rounded(value)) for name, value in figures.items()}
