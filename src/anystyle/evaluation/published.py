"""Figures that papers printed, and whether they agree with themselves."""

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

BUNDLED = Path(__file__).with_name("published.json")
TOLERANCE = 0.05
"""How far a printed ArtFID may lie from its printed parts: what rounding of these explains."""

FROM_PARTS = "art_fid_from_parts"

BETTER = {
    "art_score": "higher",
    **dict.fromkeys(("art_fid", "fid", "lpips", "lpips_gray", "cfsd", "color_match"), "lower"),
    **{f"warp_{what}_{span}": "lower" for span in ("short", "long") for what in ("lpips", "rmse")},
}
"""Which way the figures of the paper's tables are better."""


@dataclass(frozen=True)
class PublishedFigure:
    """One number of a paper's table.

    Args:
        method: What it judges.
        scene: On which scene.
        figure: Its name, as metrics call it.
        value: As printed.
        table: Where in the paper.
        source: Which paper, and how it was read.
    """

    method: str
    scene: str
    figure: str
    value: float
    table: str
    source: str


@dataclass(frozen=True)
class Disagreement:
    """A printed ArtFID that its own parts do not give.

    Args:
        method: What it judges.
        scene: On which scene.
        printed: As printed.
        recomputed: ``(1 + LPIPS)(1 + FID)``.
    """

    method: str
    scene: str
    printed: float
    recomputed: float


def load(more: Sequence[Path] = ()) -> list[PublishedFigure]:
    """The figures that come with the package, and those of further files of the same form.

    Args:
        more: JSON files with ``sources`` and ``rows``.

    Raises:
        ValueError: A file cannot be read, or is of another form.
    """
    return [figure for path in (BUNDLED, *more) for figure in _read(path)]


def disagreements(figures: Sequence[PublishedFigure], tolerance: float = TOLERANCE) -> list[Disagreement]:
    """Recompute ArtFID from its parts wherever these are known, and list where the printed one differs.

    ArtFID is ``(1 + LPIPS)(1 + FID)`` (Wright and Ommer, 2022). Figures of one method, scene and paper belong together.

    Args:
        figures: Of any tables.
        tolerance: What rounding may explain.
    """
    rows: dict[tuple[str, str, str], dict[str, float]] = {}
    for item in figures:
        rows.setdefault((item.method, item.scene, item.source), {})[item.figure] = item.value
    found: list[Disagreement] = []
    for (method, scene, _), row in rows.items():
        parts = row.get(FROM_PARTS, art_fid(row.get("lpips", math.nan), row.get("fid", math.nan)))
        gap = abs(row.get("art_fid", math.nan) - parts)
        if gap > tolerance:
            found.append(Disagreement(method, scene, row["art_fid"], parts))
    return found


def art_fid(lpips: float, fid: float) -> float:
    """``(1 + LPIPS)(1 + FID)``."""
    return (1 + lpips) * (1 + fid)


def _read(path: Path) -> list[PublishedFigure]:
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
        return [
            PublishedFigure(
                str(row["method"]), str(scene), str(figure), float(value), str(row["table"]),
                str(stored["sources"][row["source"]]),
            )
            for row in stored["rows"]
            for figure, values in row["figures"].items()
            for scene, value in values.items()
        ]  # fmt: skip
    except OSError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise ValueError(
            f"{path} holds no published figures ({type(error).__name__}: {error}); expected 'sources' and 'rows', "
            f"as in {BUNDLED.name}"
        ) from None
