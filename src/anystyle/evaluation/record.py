"""The files of one evaluation: written by the command, read by the report."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from anystyle.evaluation.contract import SCENE, Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, Table, figures_table
from anystyle.io.atomic import atomic_path

FILE = "metrics.json"


def write(evaluation: Evaluation, out: Path, provenance: Mapping[str, Any]) -> Table:
    """Write ``metrics.json``, ``metrics.csv``, ``table.md`` and ``table.tex``.

    Args:
        evaluation: The result of a protocol.
        out: The folder.
        provenance: What the command adds to the evaluation's, such as weights and seconds.

    Returns:
        The table.
    """
    evaluation = _with_times(evaluation.with_facts(**provenance))
    stored = {
        **_plain(evaluation.figures),
        **{name: _plain(group) for name, group in evaluation.groups.items()},
        "provenance": {
            **evaluation.provenance,
            "n": evaluation.n,
            "better": dict(evaluation.better),
            "stand_ins": dict(evaluation.stand_ins),
        },
    }
    table = summary(evaluation)
    texts = {
        FILE: json.dumps(stored, indent=2, ensure_ascii=False) + "\n",
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
    return Evaluation(
        figures=figures,
        n=provenance.get("n", 0),
        better=provenance.get("better", {}),
        groups=groups,
        stand_ins=provenance.get("stand_ins", {}),
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


def _plain(figures: Mapping[str, float]) -> dict[str, float | None]:
    # JSON has no nan.
    return {name: None if math.isnan(value) else value for name, value in figures.items()}


def _float(value: Any) -> float:
    return math.nan if value is None else float(value)
