"""Survival of geometry: whether structure from motion still finds how the camera moved between stylized views."""

import tempfile
import warnings
from collections.abc import Mapping, Sequence
from math import inf, nan
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from anystyle.contracts import Metric, accepts_tensors
from anystyle.ranges import Range
from anystyle.registry.catalog import catalog
from anystyle.types import Cameras, Comparison

FIGURES = ("pose_auc", "registered", "camera_error")
LIMIT = 20.0  # degrees at which ``pose_auc`` ends


class GeometrySurvival(Metric):
    """How well SIFT and COLMAP find the motion from each view to the next in the stylized views alone.

    ``registered`` is the share of pairs for which one motion explains at least 15 matches. The error of such a pair is
    the larger of two angles: between its rotation and the cameras', and between its translation's direction and
    theirs. ``camera_error`` is the median in degrees over a row's registered pairs, and ``pose_auc`` the area under the
    share of all pairs that have less than an error, up to 20 degrees (Sarlin et al., SuperGlue, CVPR 2020, section 5;
    exact instead of by trapezoids): in [0, 1], 0 for a pair that does not register.

    Cameras' intrinsics are given. Motions of pairs are the first half of structure from motion: the second half, which
    joins them, needs more views or pixels than a comparison has. Rows without cameras, or with one view, are left out.
    Needs the plugin ``anystyle-captures``, with pycolmap.

    Args:
        min_side: Smaller views are enlarged to this longer side in pixels, in which SIFT finds more features.

    Example:
        >>> intrinsics, poses = torch.eye(3).repeat(1, 2, 1, 1), torch.eye(4).repeat(1, 2, 1, 1)
        >>> flat = torch.full((1, 2, 3, 64, 64), 0.5)  # SIFT finds nothing
        >>> GeometrySurvival(min_side=64)(flat, cameras=Cameras(poses, intrinsics, (64, 64)))
        {'pose_auc': tensor(0.), 'registered': tensor(0.), 'camera_error': tensor(nan)}
    """

    better: ClassVar[Mapping[str, str]] = dict(zip(FIGURES, ("higher", "higher", "lower"), strict=True))
    takes = ("preds", "cameras", "numbers")
    full_state_update = False
    totals: Tensor
    rows: Tensor

    def __init__(self, *, min_side: Annotated[int, Range(ge=16)] = 512) -> None:
        super().__init__()
        self.min_side = min_side
        self._last: tuple[tuple[Tensor, ...], np.ndarray] | None = None
        self.add_state("totals", torch.zeros(3, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros(3, dtype=torch.long), dist_reduce_fx="sum")

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"min_side": 64}

    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        if comparison.cameras is None or not comparison.neighbours():
            return
        for row in range(len(comparison.stylized)):
            one = comparison.row(row)
            errors = self._errors(one)
            found = np.isfinite(errors)
            middle = float(np.median(errors[found])) if found.any() else nan
            values = torch.tensor([np.clip(1 - errors / LIMIT, 0, 1).mean(), found.mean(), middle]).to(self.totals)
            self.rows += values.isfinite()
            self.totals += values.nan_to_num()

    def _errors(self, row: Comparison) -> Float64[np.ndarray, " pairs"]:
        """Of a row's pairs; the last row's where views are the same, as those of a method that ignores its style."""
        assert row.cameras is not None
        neighbours = row.neighbours()
        views = row.stylized, row.cameras.world_from_camera, row.cameras.intrinsics, torch.tensor(neighbours)
        if self._last is None or not all(map(torch.equal, self._last[0], views)):
            self._last = views, np.array(pose_errors(row.stylized[0], row.cameras, neighbours, self.min_side))
        return self._last[1]

    def compute(self) -> dict[str, Tensor]:
        if int(self.rows[0]) == 0:
            warnings.warn("geometry_survival: no two views with cameras; the figures are nan", stacklevel=2)
        return dict(zip(FIGURES, (self.totals / self.rows).float(), strict=True))  # nan where there is no row


def pose_errors(
    views: Float[Tensor, "V 3 H W"], cameras: Cameras, pairs: Sequence[tuple[int, int]], min_side: int = 512
) -> list[float]:
    """The error in degrees of the motion between the views of each pair; infinite where none is found."""
    catalog().find("pose_estimator", "sfm").load()  # where its package is not installed, this makes it importable
    from anystyle_captures.sfm.colmap import match, motion
    from anystyle_captures.sfm.model import Photograph, SearchOptions

    pixels = (views.clamp(0, 1) * 255).round().byte().permute(0, 2, 3, 1).cpu().numpy()
    intrinsics, poses = (each[0].double().cpu().numpy() for each in (cameras.intrinsics, cameras.world_from_camera))
    photographs = [
        Photograph(str(index), image, focal)
        for index, (image, focal) in enumerate(zip(pixels, intrinsics[:, 0, 0].tolist(), strict=True))
    ]
    with tempfile.TemporaryDirectory() as folder:
        graph = match(Path(folder), photographs, SearchOptions(min_side=min_side), pairs=[*pairs])
    errors = dict.fromkeys(pairs, inf)
    for pair in graph.pairs:
        found = motion(graph, pair, [intrinsics[pair.first], intrinsics[pair.second]], cameras.size)
        if found is not None:
            errors[pair.first, pair.second] = pose_error(found, np.linalg.solve(poses[pair.second], poses[pair.first]))
    return [*errors.values()]


def pose_error(found: Float64[np.ndarray, "3 4"], known: Float64[np.ndarray, "4 4"]) -> float:
    """The larger of the angles in degrees between two motions' rotations and between their translations' directions.

    A right angle stands for the direction of no translation; where the known motion has none, rotations count alone.
    """
    cosines = [(np.trace(found[:, :3].T @ known[:3, :3]) - 1) / 2]
    if (known[:3, 3] != 0).any():
        lengths = np.linalg.norm(found[:, 3]) * np.linalg.norm(known[:3, 3])
        cosines.append(found[:, 3] @ known[:3, 3] / max(lengths, 1e-12))
    return float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max())
