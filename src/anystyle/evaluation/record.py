"""The files of one evaluation: written by the command, read by the report."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec

from anystyle.documents import Count, Figure, as_number, fit, plain, read_json
from anystyle.evaluation.contract import SCENE, Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, Table, figures_table
from anystyle.io.atomic import atomic_path

FILE = "metrics.json"


class _Facts(msgspec.Struct):
    """The part of an evaluation's provenance that is read back; the rest is handed on."""

    n: Count = 0
    better: dict[str, Literal["higher", "lower"]] = {}
    stand_ins: dict[str, str] = {}
    title: str = ""
    variant: str | None = None
    machine: str = ""
    seconds: float = 0
    protocol: str = ""
    warnings: list[str] = []
    scenes: list[str] = []


def write(evaluation: Evaluation, out: Path, provenance: Mapping[str, Any]) -> Table:
    """Write ``metrics.json``, ``metrics.csv``, ``table.md`` and ``table.tex``, and return the table."""
    evaluation = _with_times(evaluation.with_facts(**provenance))
    stored = {
        **evaluation.figures,
        **evaluation.groups,
        "provenance": {
            **evaluation.provenance,
            "n": evaluation.n,
            "better": dict(evaluation.better),
            "stand_ins": dict(evaluation.stand_ins),
        },
    }
    table = summary(evaluation)
    texts = {
        FILE: json.dumps(plain(stored), indent=2, ensure_ascii=False, allow_nan=False) + "\n",
        "metrics.csv": rows_table(evaluation.rows, evaluation.stand_ins).csv(),
        "table.md": table.markdown(),
        "table.tex": table.latex(),
    }
    for name, text in texts.items():
        with atomic_path(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return table


def read(folder: Path) -> Evaluation | None:
    """The evaluation in a folder, without its rows; ``None`` where there is none.

    Raises:
        ValueError: There is one that cannot be read.
    """
    path = folder / FILE
    if not path.is_file():
        return None
    stored: dict[str, Any] = read_json(path, dict[str, Any], what="file of figures; evaluate again")
    if "provenance" not in stored:
        return None  # the last values that a training logged have this file name too
    what = "file of figures of an evaluation; evaluate again"
    provenance = stored.pop("provenance")
    facts: _Facts = fit(provenance, _Facts, source=str(path), what=what)
    figures: dict[str, Figure | dict[str, Figure]] = fit(
        stored, dict[str, Figure | dict[str, Figure]], source=str(path), what=what
    )
    return Evaluation(
        figures={name: as_number(value) for name, value in figures.items() if not isinstance(value, dict)},
        n=facts.n,
        better=facts.better,
        groups={
            name: {key: as_number(item) for key, item in value.items()}
            for name, value in figures.items()
            if isinstance(value, dict)
        },
        stand_ins=facts.stand_ins,
        provenance=provenance,
    )


def summary(evaluation: Evaluation) -> Table:
    """The table of one evaluation: a row for each figure, a column for all scenes and for each group."""
    provenance, groups = evaluation.provenance, evaluation.groups
    columns = {provenance.get("title", "all" if groups else "value"): evaluation.figures}
    columns |= {name.removeprefix(SCENE): group for name, group in groups.items()}
    variant = f", {provenance['variant']}" if provenance.get("variant") else ""
    machine = provenance.get("machine", "an unknown machine")
    notes = [f"n = {evaluation.n}, {provenance.get('seconds', 0):.0f} s on {machine}."]
    if any(name.startswith(SCENE) for name in groups):
        notes.append("“all” is the mean of the scenes, each judged on its own.")
    if evaluation.stand_ins:
        notes.append(
            f"{STAND_IN.capitalize()}: these figures come from networks that stand in for published ones, and agree "
            "with no published figure."
        )
    notes += [f"Warning: {text}" for text in provenance.get("warnings", [])]
    caption = f"{provenance.get('protocol', 'evaluation')}{variant}"
    return figures_table(columns, evaluation.better, evaluation.stand_ins, caption=caption, notes=notes)


def _with_times(evaluation: Evaluation) -> Evaluation:
    """Measured seconds as figures, which they are in every table and file."""
    return replace(
        evaluation,
        figures={**evaluation.figures, **evaluation.times},
        better={**evaluation.better, **dict.fromkeys(evaluation.times, "lower")},
    )


def rows_table(rows: Sequence[Row], stand_ins: Mapping[str, str]) -> Table:
    """A row for each scene in each style; the last column names the figures of stand-in networks, if there are any."""
    names = list(dict.fromkeys(name for row in rows for name in row.figures))
    from_stand_ins = [name for name in names if name in stand_ins]
    note = [f"{STAND_IN}: {' '.join(from_stand_ins)}"] if from_stand_ins else []
    cells = [(row.scene, row.style, *(_full(row.figures.get(name)) for name in names), *note) for row in rows]
    return Table(("scene", "style", *names, *(["note"] if note else [])), tuple(cells))


def _full(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else repr(value)
