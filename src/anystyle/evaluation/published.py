"""Figures that papers printed, the tables they stand in, and whether they agree with themselves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import msgspec

from anystyle.documents import read_json

BUNDLED = Path(__file__).with_name("published.json")

_SECONDS = {"s": 1.0, "m": 60.0}
_PROPERTIES = {"yes": 1.0, "no": 0.0}


@dataclass(frozen=True)
class PublishedFigure:
    """One cell of a paper's table.

    Args:
        method: What it judges, as the table calls it.
        scene: On which scene; empty for all.
        figure: Its name, as metrics call it.
        value: As a number: times in seconds, properties 1 or 0.
        printed: As printed.
        table: Where in the paper.
        source: Which paper, and how it was read.
        known_as: The method's name in the paper's other tables, where it has another there.
        origin: The kind of method, and where the paper says that its figure comes from.
        mark: ``1st`` or ``2nd`` where the paper marks the cell so.
    """

    method: str
    scene: str
    figure: str
    value: float
    printed: str
    table: str
    source: str
    known_as: str = ""
    origin: str = ""
    mark: str = ""

    @property
    def half_unit(self) -> float:
        """Half a unit of the last printed digit: how far the exact value may be off."""
        return 0.5 * 10.0 ** -len(self.printed.partition(".")[2])


@dataclass(frozen=True)
class PublishedTable:
    """The form of a paper's table.

    Args:
        name: As ``anystyle report --paper`` takes it.
        title: What it shows.
        source: The paper.
        figures: Its figures, in order.
        scenes: Its scenes, in order; none where a table is of methods alone.
        notes: What its cells do not say.
    """

    name: str
    title: str
    source: str
    figures: tuple[str, ...]
    scenes: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True)
class Disagreement:
    """A printed ArtFID that its own parts do not give."""

    method: str
    scene: str
    printed: float
    recomputed: float


def load(more: Sequence[Path] = ()) -> list[PublishedFigure]:
    """The figures that come with the package, and those of further JSON files of the same form.

    Raises:
        ValueError: A file cannot be read, or is of another form.
    """
    return [figure for path in (BUNDLED, *more) for figure in _read(path)]


def tables() -> dict[str, PublishedTable]:
    """The tables of the AnyStyle paper, by name."""
    stored = _bundled()
    return {
        name: PublishedTable(
            name, table["title"], stored["sources"][table["source"]], tuple(table["figures"]), tuple(table["scenes"]),
            tuple(table["notes"]),
        )
        for name, table in stored["tables"].items()
    }  # fmt: skip


def better() -> dict[str, str]:
    """``higher`` or ``lower`` for each figure of the tables that has a direction."""
    return dict(_bundled()["better"])


def disagreements(figures: Sequence[PublishedFigure]) -> list[Disagreement]:
    """The printed ArtFID that differ from those of their parts by more than rounding to the printed digits explains.

    ArtFID is ``(1 + LPIPS)(1 + FID)`` (Wright and Ommer, 2022). Figures of one method, scene and paper belong together.
    """
    rows: dict[tuple[str, str, str], dict[str, PublishedFigure]] = {}
    for item in figures:
        rows.setdefault((item.known_as or item.method, item.scene, item.source), {})[item.figure] = item
    disagreements: list[Disagreement] = []
    for (method, scene, _), row in rows.items():
        if not {"art_fid", "lpips", "fid"} <= row.keys():
            continue
        printed, lpips, fid = row["art_fid"], row["lpips"], row["fid"]
        low = art_fid(lpips.value - lpips.half_unit, fid.value - fid.half_unit) - printed.half_unit
        high = art_fid(lpips.value + lpips.half_unit, fid.value + fid.half_unit) + printed.half_unit
        if not low <= printed.value <= high:
            disagreements.append(Disagreement(method, scene, printed.value, art_fid(lpips.value, fid.value)))
    return disagreements


def art_fid(lpips: float, fid: float) -> float:
    """``(1 + LPIPS)(1 + FID)``."""
    return (1 + lpips) * (1 + fid)


@lru_cache(1)
def _bundled() -> dict[str, Any]:
    return read_json(BUNDLED, dict[str, Any])


def _read(path: Path) -> list[PublishedFigure]:
    what = f"file of published figures, with 'sources' and 'rows' as in {BUNDLED.name}"
    stored: _Published = read_json(path, _Published, what=what)
    strange = [row.source for row in stored.rows if row.source not in stored.sources]
    if strange:
        raise ValueError(f"{path} is no {what} (there is no source {strange[0][:80]!r})")
    try:
        return [cell for row in stored.rows for cell in _cells(row, stored)]
    except ValueError as error:
        raise ValueError(f"{path} is no {what} ({error})") from None


class _Row(msgspec.Struct):
    """A method's row of a table: for each figure its cells by scene, as printed."""

    method: str
    source: str
    table: str
    figures: dict[str, dict[str, str | float]]
    marks: dict[str, dict[str, str]] = {}
    family: str | None = None
    origin: str | None = None


class _Published(msgspec.Struct):
    """A file of figures that papers printed."""

    sources: dict[str, str]
    rows: list[_Row]
    aliases: dict[str, str] = {}


def _cells(row: _Row, stored: _Published) -> list[PublishedFigure]:
    origin = "; ".join(text for text in (row.family, row.origin) if text is not None)
    return [
        PublishedFigure(
            row.method, scene, figure, _value(str(printed)), str(printed), row.table, stored.sources[row.source],
            stored.aliases.get(row.method, row.method), origin, row.marks.get(figure, {}).get(scene, ""),
        )
        for figure, cells in row.figures.items()
        for scene, printed in cells.items()
    ]  # fmt: skip


def _value(printed: str) -> float:
    if printed in _PROPERTIES:
        return _PROPERTIES[printed]
    seconds = _SECONDS.get(printed[-1:], 1.0)
    value = float(printed.rstrip("sm ")) * seconds
    if not math.isfinite(value):
        raise ValueError(f"{printed} is no figure")
    return value
