"""The files of one evaluation: written by the command, read by the report."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from anystyle.evaluation.contract import Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, Table, figures_table
from anystyle.files import atomic_path

FILE = "metrics.json"
_SCENE = "scene "


@dataclass(frozen=True)
class Record:
    """An evaluation as it lies on disk.

    Args:
        figures: Value by name.
        groups: More of them by group.
        provenance: What they rest on.
    """

    figures: Mapping[str, float]
    groups: Mapping[str, Mapping[str, float]]
    provenance: Mapping[str, Any]

    @property
    def stand_ins(self) -> dict[str, str]:
        """The stand-in network behind a figure, where there is one."""
        return dict(self.provenance.get("stand_ins", {}))

    @property
    def better(self) -> dict[str, str]:
        """``higher`` or ``lower`` by figure."""
        return dict(self.provenance.get("better", {}))

    @property
    def scenes(self) -> dict[str, Mapping[str, float]]:
        """The figures of each scene; those of the only one are all there are."""
        found = {name.removeprefix(_SCENE): group for name, group in self.groups.items() if name.startswith(_SCENE)}
        only = self.provenance.get("scenes", [])
        return found or ({str(only[0]): self.figures} if len(only) == 1 and only[0] else {})


def write(found: Evaluation, out: Path, provenance: Mapping[str, Any]) -> Table:
    """Write ``metrics.json``, ``metrics.csv``, ``table.md`` and ``table.tex``.

    Args:
        found: What a protocol returned.
        out: The folder.
        provenance: What the command knows of it, such as weights and seconds.

    Returns:
        The table.
    """
    everything = {
        **{key: value for key, value in found.provenance.items() if key not in provenance},
        **provenance,
        "n": found.n,
        "better": dict(found.better),
        "stand_ins": dict(found.stand_ins),
    }
    stored = {**_plain(found.figures), **{name: _plain(group) for name, group in found.groups.items()}}
    _text(out / FILE, json.dumps({**stored, "provenance": everything}, indent=2, ensure_ascii=False) + "\n")
    _text(out / "metrics.csv", rows_table(found.rows, found.stand_ins).csv())
    table = summary(Record(found.figures, found.groups, everything))
    _text(out / "table.md", table.markdown())
    _text(out / "table.tex", table.latex())
    return table


def read(folder: Path) -> Record | None:
    """What :func:`write` wrote; ``None`` where there is no evaluation.

    Raises:
        ValueError: There is one that cannot be read.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    try:
        stored = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise ValueError(f"{path} is damaged ({str(error).splitlines()[0]}); evaluate again") from None
    if not isinstance(stored, dict) or not isinstance(stored.get("provenance"), dict):
        return None  # the last values that a training logged have this file name too
    provenance = stored.pop("provenance")
    figures = {name: _float(value) for name, value in stored.items() if not isinstance(value, dict)}
    groups = {
        name: {key: _float(item) for key, item in value.items()}
        for name, value in stored.items()
        if isinstance(value, dict)
    }
    return Record(figures, groups, provenance)


def summary(record: Record) -> Table:
    """The table of one evaluation: a row for each figure, a column for all and for each group."""
    known = record.provenance
    columns = {"all" if record.groups else "value": record.figures}
    columns |= {name.removeprefix(_SCENE): group for name, group in record.groups.items()}
    variant = f", {known['variant']}" if known.get("variant") else ""
    notes = [f"n = {known.get('n')}, {known.get('seconds', 0):.0f} s on {known.get('machine', 'an unknown machine')}."]
    if any(name.startswith(_SCENE) for name in record.groups):
        notes.append("“all” is the mean of the scenes, each judged on its own.")
    if record.stand_ins:
        notes.append(
            f"{STAND_IN[0].upper()}{STAND_IN[1:]}: these figures come from networks that stand in for published ones, "
            "and agree with no published figure."
        )
    notes += [f"Warning: {text}" for text in known.get("warnings", [])]
    caption = f"{known.get('protocol', 'evaluation')}{variant}"
    return figures_table(columns, record.better, record.stand_ins, caption=caption, notes=notes)


def rows_table(rows: tuple[Row, ...], stand_ins: Mapping[str, str]) -> Table:
    """A row for each scene in each style; the last column names the figures of stand-in networks."""
    names = list(dict.fromkeys(name for row in rows for name in row.figures))
    said = [name for name in names if name in stand_ins]
    note = [f"{STAND_IN}: {' '.join(said)}"] if said else []
    cells = [(row.scene, row.style, *(_full(row.figures.get(name)) for name in names), *note) for row in rows]
    return Table(("scene", "style", *names, *(["note"] if note else [])), tuple(cells))


def _full(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else repr(value)


def _plain(figures: Mapping[str, float]) -> dict[str, float | None]:
    # JSON has no word for "not a number".
    return {name: None if math.isnan(value) else value for name, value in figures.items()}


def _float(value: Any) -> float:
    return math.nan if value is None else float(value)


def _text(path: Path, text: str) -> None:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
