"""The files of one evaluation: written by the command, read by the report."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import msgspec

from anystyle.contracts.protocol import SCENE, Evaluation, Row
from anystyle.evaluation.tables import STAND_IN, Table, number, titled
from anystyle.io.atomic import write_json, write_text
from anystyle.io.documents import Number, as_number, fit, read_json
from anystyle.ranges import Count

FILE = "metrics.json"


class _Gap(msgspec.Struct):
    scene: str
    missing: Count


class _Facts(msgspec.Struct):
    """The part of an evaluation's provenance that is read back."""

    n: Count = 0
    better: dict[str, Literal["higher", "lower"]] = {}
    stand_ins: dict[str, str] = {}
    scenes: list[str] = []
    missing: list[_Gap] = []


def write(evaluation: Evaluation, out: Path, provenance: Mapping[str, Any]) -> Evaluation:
    """Write ``metrics.json``, ``metrics.csv``, ``table.md`` and ``table.tex``; the evaluation with its provenance."""
    evaluation = replace(
        evaluation.with_facts(**provenance),
        scores={**evaluation.scores, **evaluation.times},
        better={**evaluation.better, **dict.fromkeys(evaluation.times, "lower")},
    )
    facts = {"n": evaluation.n, "better": dict(evaluation.better), "stand_ins": dict(evaluation.stand_ins)}
    table = summary(evaluation)
    rows = rows_table(evaluation.rows, evaluation.stand_ins)
    for name, text in {"metrics.csv": rows.csv(), "table.md": table.markdown(), "table.tex": table.latex()}.items():
        write_text(out / name, text)
    stored = {**evaluation.scores, **evaluation.groups, "provenance": {**evaluation.provenance, **facts}}
    write_json(out / FILE, stored)
    return evaluation


def read(folder: Path) -> Evaluation | None:
    """The evaluation in a folder, without its rows; ``None`` where there is none."""
    path = folder / FILE
    if not path.is_file():
        return None
    stored: dict[str, Any] = read_json(path, dict[str, Any], what="file of scores; evaluate again")
    if "provenance" not in stored:
        return None  # the last values that a training logged have this file name too
    what = "file of scores of an evaluation; evaluate again"
    provenance = stored.pop("provenance")
    facts: _Facts = fit(provenance, _Facts, source=str(path), what=what)
    shape = dict[str, Number | dict[str, Number]]
    known: dict[str, Number | dict[str, Number]] = fit(stored, shape, source=str(path), what=what)
    scores = {name: as_number(value) for name, value in known.items() if not isinstance(value, dict)}
    groups = {
        name: {key: as_number(item) for key, item in value.items()}
        for name, value in known.items()
        if isinstance(value, dict)
    }
    return Evaluation(scores, facts.n, facts.better, groups, stand_ins=facts.stand_ins, provenance=provenance)


def summary(evaluation: Evaluation) -> Table:
    """The table of one evaluation: a row for each score, a column for all scenes and for each group.

    Groups that outnumber the scores are the rows. Scores of stand-in networks have a mark.
    """
    provenance, groups = evaluation.provenance, evaluation.groups
    title = provenance.get("title", "")
    columns = {_lacking(title or ("all" if groups else "value"), evaluation.missing(title)): evaluation.scores}
    columns |= {_lacking(name.removeprefix(SCENE), evaluation.missing(name)): group for name, group in groups.items()}
    seconds, machine = provenance.get("seconds", 0), provenance.get("machine", "an unknown machine")
    notes = [f"n = {evaluation.size}, {seconds:.0f} s on {machine}."]
    if any(name.startswith(SCENE) for name in groups):
        notes.append("“all” is the mean of the scenes, each judged on its own.")
    if evaluation.stand_ins:
        networks = ", ".join(f"{name} by {network}" for name, network in evaluation.stand_ins.items())
        notes.append(f"† {STAND_IN} with published scores: {networks}.")
    notes += [f"Warning: {text}" for text in provenance.get("warnings", [])]
    caption = ", ".join(filter(None, (provenance.get("protocol", "evaluation"), provenance.get("variant"))))
    names = list(dict.fromkeys(name for scores in columns.values() for name in scores))
    wide = len(columns) > len(names)
    grid = [("" if wide else "score", *columns)]
    for name in names:
        label = f"{titled(name, evaluation.better)}{' †' if name in evaluation.stand_ins else ''}"
        grid.append((label, *(number(scores.get(name)) for scores in columns.values())))
    head, *rows = zip(*grid, strict=True) if wide else grid
    return Table(head, tuple(rows), caption, tuple(notes))


def _lacking(title: str, missing: int) -> str:
    return f"{title} ({missing} missing)" if missing else title


def rows_table(rows: Sequence[Row], stand_ins: Mapping[str, str]) -> Table:
    """A row for each scene in each style, with the number of its images and of those missing where they were counted.

    The last column names the scores of stand-in networks, if there are any.
    """
    names = list(dict.fromkeys(name for row in rows for name in row.scores))
    from_stand_ins = [name for name in names if name in stand_ins]
    note = [f"{STAND_IN}: {' '.join(from_stand_ins)}"] if from_stand_ins else []
    heads = ["n", "missing"] if any(row.n is not None for row in rows) else []
    cells: list[tuple[str, ...]] = []
    for row in rows:
        values = (row.scores.get(name, math.nan) for name in names)
        scores = ("" if math.isnan(value) else repr(value) for value in values)
        cells.append((row.scene, row.style, *(str(getattr(row, head)) for head in heads), *scores, *note))
    return Table(("scene", "style", *heads, *names, *(["note"] if note else [])), tuple(cells))
