"""Finished scenes of a held-out evaluation on disk, and the figures of all of them together."""

import hashlib
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from statistics import fmean, median
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.documents import kept_json
from anystyle.io.atomic import atomic_path
from anystyle_tiny.evaluation.geometry import degrees, mean_motion
from anystyle_tiny.evaluation.styles import rises

Record = Mapping[str, Mapping[str, Sequence[float]]]
"""What is known of one scene: plain numbers by group and name."""

FOLDER = "parts"

BETTER: dict[str, str] = {
    "retrieval_text_to_image": "higher",
    "retrieval_image_to_text": "higher",
    "rotation_error_median_deg": "lower",
    "translation_direction_error_median_deg": "lower",
    "depth_abs_rel": "lower",
    "psnr_input_views": "higher",
    "psnr_novel_views": "higher",
    "style_retrieval_image": "higher",
    "style_retrieval_text": "higher",
    "color_match_ratio": "lower",
    "edge_correlation": "higher",
    "interpolation_monotone": "higher",
}
"""The figures, in the order of the table."""


def seal(modules: Sequence[nn.Module], options: Mapping[str, object]) -> str:
    """What records depend on: every weight, and the options."""
    digest = hashlib.sha256(json.dumps(dict(options), sort_keys=True).encode())
    for module in modules:
        for name, tensor in module.state_dict().items():
            digest.update(name.encode())
            digest.update(tensor.detach().cpu().contiguous().flatten().view(torch.uint8).numpy().tobytes())
    return digest.hexdigest()


def kept(path: Path, mark: str, make: Callable[[], Record]) -> Record:
    """A record as it lies on disk, computed and written first where there is none of this seal."""
    stored: Record | None = kept_json(path, dict[str, Any])
    if stored is not None and stored.pop("seal", None) == mark:
        return stored
    record = make()
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps({"seal": mark, **record}) + "\n", encoding="utf-8")
    return record


def geometry_figures(records: Sequence[Mapping[str, Sequence[float]]]) -> dict[str, float]:
    """Medians of angles over all pairs of views, and means of the rest."""
    return {
        "rotation_error_median_deg": _median(records, "rotation_deg"),
        "translation_direction_error_median_deg": _median(records, "direction_deg"),
        "depth_abs_rel": _mean(records, "depth_abs_rel"),
        "psnr_input_views": _mean(records, "psnr_input_views"),
        "psnr_novel_views": _mean(records, "psnr_novel_views"),
    }


def baseline_figures(records: Sequence[Mapping[str, Sequence[float]]]) -> dict[str, float]:
    """What guessing the mean gives: for cameras, the constant motion of each view that fits these scenes best."""
    rotations = torch.tensor([record["rotations"] for record in records]).unflatten(-1, (-1, 3, 3))
    directions = torch.tensor([record["directions"] for record in records]).unflatten(-1, (-1, 3))
    rotation, direction = mean_motion(rotations, directions)
    cosine = ((rotation.mT @ rotations).diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    return {
        "rotation_error_median_deg": _middle(degrees(cosine.flatten())),
        "translation_direction_error_median_deg": _middle(degrees((directions * direction).sum(-1).flatten())),
        "depth_abs_rel": _mean(records, "depth_abs_rel"),
        "psnr_input_views": _mean(records, "psnr_input_views"),
        "psnr_novel_views": _mean(records, "psnr_novel_views"),
    }


def style_figures(
    styles: Sequence[Mapping[str, Sequence[float]]], strips: Sequence[Mapping[str, Sequence[float]]], num_styles: int
) -> tuple[dict[str, float], dict[str, float]]:
    """The figures of style, and those that unstyled renders would get."""
    figures = {
        "style_retrieval_image": _retrieved(styles, "chosen_image", num_styles),
        "style_retrieval_text": _retrieved(styles, "chosen_text", num_styles),
        "color_match_ratio": _mean(styles, "color") / max(_mean(styles, "unstyled_color"), 1e-12),
        "edge_correlation": _mean(styles, "edge_correlation"),
        "interpolation_monotone": _fraction([rises(record["fractions"]) for record in strips]),
    }
    # An unstyled render looks like one style, whichever was asked for: right once in as many as there are.
    chance = 1.0 / num_styles
    unstyled = {
        "style_retrieval_image": chance,
        "style_retrieval_text": chance,
        "color_match_ratio": 1.0,
        "edge_correlation": 1.0,
        "interpolation_monotone": 0.0 if strips else math.nan,
    }
    return figures, unstyled


def _retrieved(records: Sequence[Mapping[str, Sequence[float]]], name: str, num_styles: int) -> float:
    """The fraction of choices, in the order styles, then views, that are the style itself."""
    views = len(records[0][name]) // num_styles
    return _fraction([int(choice) == row // views for record in records for row, choice in enumerate(record[name])])


def _all(records: Sequence[Mapping[str, Sequence[float]]], name: str) -> list[float]:
    return [value for record in records for value in record[name]]


def _median(records: Sequence[Mapping[str, Sequence[float]]], name: str) -> float:
    values = _all(records, name)
    return float(median(values)) if values else math.nan


def _mean(records: Sequence[Mapping[str, Sequence[float]]], name: str) -> float:
    values = _all(records, name)
    return float(fmean(values)) if values else math.nan


def _fraction(held: Sequence[bool]) -> float:
    return float(fmean(held)) if held else math.nan


def _middle(values: Float[Tensor, " v"]) -> float:
    return float(median(values.tolist()))
