"""Cameras and sparse points from photographs."""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64, UInt8

from anystyle.reconstructions.kept import kept, key_of
from anystyle.reconstructions.order import canonical_order
from anystyle.reconstructions.sfm.matches import pairs_to_match
from anystyle.reconstructions.sfm.model import Lens, SparseModel, Tracks, undistorted_image, undistorted_model
from anystyle.reconstructions.sfm.photographs import Enlargement, Photograph
from anystyle.reconstructions.sfm.verdict import FEWEST_VIEWS, Capture, Verdict, judge

Array = np.ndarray
Progress = Callable[[str, int, int], None]
"""Told of a stage, how much of it is done, and of how much."""


@dataclass(frozen=True)
class PosedPhotographs:
    """Photographs of one capture without distortion, with cameras where they were found.

    Args:
        names: Of all photographs, in the order given.
        images: Undistorted, of the sizes given; those of a lens that is not known as they came.
        world_from_camera: OpenCV axes, in a frame and unit of the capture's own; NaN where no camera was found.
        intrinsics: In pixels of ``images``, without distortion; NaN where nothing is known.
        points: Sparse points of the scene.
        tracks: Which photograph sees which point where, in pixels of ``images``.
        verdict: How far this can be trusted, and what was left out.
        lenses: That the photographs were taken with, distortion included; ``None`` where nothing is known.
        kept: Whether an earlier run found them.
    """

    names: tuple[str, ...]
    images: tuple[UInt8[Array, "H W 3"], ...]
    world_from_camera: Float64[Array, "V 4 4"]
    intrinsics: Float64[Array, "V 3 3"]
    points: Float64[Array, "P 3"]
    tracks: Tracks
    verdict: Verdict
    lenses: tuple[Lens | None, ...]
    kept: bool = False

    @property
    def registered(self) -> Bool[Array, " V"]:
        """Which photographs have a camera."""
        return np.asarray(np.isfinite(self.world_from_camera).all((1, 2)))


def cameras_from_photographs(
    photographs: Sequence[Photograph],
    *,
    ordered: bool = False,
    num_features: int = 1500,
    sides: tuple[int, int] = (512, 768),
    seed: int = 0,
    threads: int = 1,
    keep: bool = False,
    progress: Progress | None = None,
) -> PosedPhotographs:
    """Find where photographs of one rigid scene were taken, by SIFT features and COLMAP's two mappers.

    The same photographs, seed and number of threads give the same cameras, bit for bit, in whatever order they are
    given, unless that is a path. What fails raises nothing: the verdict says it.

    Args:
        photographs: With distinct names.
        ordered: Whether they are a path, as frames of a video are; then only neighbours are matched, and frames that
            look alike.
        num_features: The strongest features of a photograph that are used.
        sides: Features are sought in photographs whose longer side is brought into this range: SIFT finds few in small
            ones.
        seed: Of all that is random.
        threads: How many to use.
        keep: Whether what is found is kept in the user's cache folder, and taken from there if it is known.
        progress: Told of every step that takes a second or more.

    Raises:
        ImportError: pycolmap is not installed.
        ValueError: There are no photographs, or two have one name.
    """
    names = tuple(photograph.name for photograph in photographs)
    if not names or len(set(names)) < len(names):
        raise ValueError(f"{len(names)} photographs with {len(set(names))} names; give one or more, of distinct names")
    copies = (torch.tensor(photograph.pixels) for photograph in photographs)
    order = list(range(len(names))) if ordered else canonical_order(copies, names)
    arranged = [photographs[view] for view in order]
    enlarged = [Enlargement.between(photograph.size, *sides) for photograph in arranged]
    report = progress or (lambda stage, done, total: None)

    def compute() -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "capture.db"
            capture = _matched(path, arranged, enlarged, ordered, num_features, seed, threads, report)
            candidates = _mapped(path, capture, enlarged, seed, threads, report)
        model, verdict = judge(capture, candidates)
        return {"model": None if model is None else model.as_dict(), "verdict": asdict(verdict)}

    pixels = (photograph.pixels for photograph in arranged)
    known = [(photograph.name, photograph.focal_length, photograph.lens) for photograph in arranged]
    key = key_of(*pixels, known, ordered, num_features, sides, seed) if keep else ""
    values, before = kept("cameras", key, compute) if keep else (compute(), False)
    model = None if values["model"] is None else SparseModel.from_dict(values["model"]).rearranged(order)
    return replace(_posed(photographs, model, Verdict(**values["verdict"])), kept=before)


def _matched(
    path: Path,
    photographs: Sequence[Photograph],
    enlarged: Sequence[Enlargement],
    ordered: bool,
    num_features: int,
    seed: int,
    threads: int,
    progress: Progress,
) -> Capture:
    """Features and matches of photographs, in a database and as far as they are judged."""
    try:
        from anystyle.reconstructions.sfm import database
    except ImportError as error:
        raise ImportError(
            "cameras from photos need pycolmap: pip install pycolmap (for Linux and Windows on x86-64, macOS on arm64)"
        ) from error
    tick = _Steps("features", len(photographs), progress)
    features = database.write_features(
        path, photographs, enlarged, num_features=num_features, threads=threads, tick=tick
    )
    pairs = pairs_to_match(features, ordered)
    tick = _Steps("matches", -(-len(pairs) // database.PAIRS_AT_ONCE), progress)
    verified = database.match(path, pairs, seed=seed, threads=threads, tick=tick)
    names = [photograph.name for photograph in photographs]
    return Capture(names, [len(one.keypoints) for one in features], [one.scaled for one in enlarged], verified)


def _mapped(
    path: Path, capture: Capture, enlarged: Sequence[Enlargement], seed: int, threads: int, progress: Progress
) -> list[list[SparseModel]]:
    """Models of both mappers."""
    from anystyle.reconstructions.sfm import mapping

    if len(enlarged) < FEWEST_VIEWS or not capture.pairs:
        return []
    tick = _Steps("cameras", len(enlarged) + 1, progress)
    incremental = mapping.map_incrementally(path, enlarged, seed=seed, threads=threads, tick=tick)
    everywhere = mapping.map_globally(path, enlarged, seed=seed, threads=threads)
    progress("cameras", len(enlarged) + 1, len(enlarged) + 1)
    return [incremental, everywhere]


class _Steps:
    """Counts steps of one stage."""

    def __init__(self, stage: str, total: int, progress: Progress) -> None:
        self._stage, self._total, self._progress, self._done = stage, total, progress, 0

    def __call__(self) -> None:
        self._done = min(self._done + 1, self._total)
        self._progress(self._stage, self._done, self._total)


def _posed(photographs: Sequence[Photograph], model: SparseModel | None, verdict: Verdict) -> PosedPhotographs:
    count = len(photographs)
    if model is None:
        nothing = np.empty(0, dtype=np.int64)
        model = SparseModel(
            np.full((count, 4, 4), np.nan),
            (None,) * count,
            np.empty((0, 3)),
            Tracks(nothing, nothing, np.empty((0, 2))),
        )
    images = tuple(
        photograph.pixels if lens is None else undistorted_image(photograph.pixels, lens)
        for photograph, lens in zip(photographs, model.lenses, strict=True)
    )
    straight = undistorted_model(model)
    nowhere = np.full((3, 3), np.nan)
    return PosedPhotographs(
        names=tuple(photograph.name for photograph in photographs),
        images=images,
        world_from_camera=straight.world_from_camera,
        intrinsics=np.stack([nowhere if lens is None else lens.intrinsics for lens in straight.lenses]),
        points=straight.points,
        tracks=straight.tracks,
        verdict=verdict,
        lenses=model.lenses,
    )
