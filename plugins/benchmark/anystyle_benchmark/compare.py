"""Which methods differ, by which figures, and which of them people prefer."""

import math
import tempfile
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np
from msgspec import Struct

from anystyle.cli.arguments import parse
from anystyle.errors import UserError, unknown
from anystyle.evaluation.tables import Table, number, titled
from anystyle.io.documents import Figure, as_figure, as_number, read_json
from anystyle_benchmark.judge import GUIDES, PHOTOGRAPHS, photographs, read_methods
from anystyle_benchmark.results import Figures
from anystyle_benchmark.statistics import CONFIDENCE, arranged, difference
from anystyle_benchmark.track import Inputs
from anystyle_study.commands import analyze_command, analyze_parser, read_plan
from anystyle_study.design import Sources, design
from anystyle_study.protocol import Study
from anystyle_study.statistics import holm
from anystyle_study.wording import p_text

ANALYSIS = "analysis.json"


class Compared(Struct, frozen=True):
    """A figure of two methods in the cells (or scenes) that both have, with its 95 % interval.

    Args:
        first: Method.
        second: Method.
        guide: ``image`` or ``text``.
        figure: Name.
        means: Of both methods, over these cells.
        difference: First minus second.
        low: Of the interval for new scenes and styles; ``None`` where there are too few to say.
        high: Likewise.
        pvalue: Two-sided.
        holm: Adjusted over all figures, guides and pairs of the comparison.
        n: Cells, or scenes.
        better: The method that is; empty where the two cannot be told apart.
    """

    first: str
    second: str
    guide: str
    figure: str
    means: tuple[Figure, Figure]
    difference: Figure
    low: Figure
    high: Figure
    pvalue: Figure
    holm: Figure
    n: int
    better: str = ""


class Answered(Struct, frozen=True):
    """What people answered to a question of a study; ``preference`` is in points, above 0 for the first method."""

    first: str
    second: str
    question: str
    preference: Figure
    low: Figure
    high: Figure
    pvalue: Figure
    holm: Figure
    participants: int
    better: str = ""


def compare(figures: Figures, methods: Sequence[str]) -> list[Compared]:
    """Every figure of every two methods."""
    if len(set(methods)) != len(methods) or len(methods) < 2:
        raise UserError("name two methods or more, each once")
    for method in methods:
        if method not in figures.methods:
            raise UserError(unknown("method in these results", method, figures.methods))
    rows = [*figures.cells, *figures.scenes]
    found: list[Compared] = []
    for pair in combinations(methods, 2):
        before = len(found)
        for guide in GUIDES:
            groups = [[row for row in rows if (row.method, row.guide) == (method, guide)] for method in pair]
            for figure in figures.metrics:
                first, second = arranged(figure, *groups)
                both = ~np.isnan(first) & ~np.isnan(second)
                if not both.any():
                    continue
                gap = difference(first, second)
                means = as_figure(float(first[both].mean())), as_figure(float(second[both].mean()))
                mean, low, high, pvalue = map(as_figure, (gap.mean, gap.low, gap.high, gap.pvalue))
                found.append(Compared(*pair, guide, figure, means, mean, low, high, pvalue, None, gap.n))
        if len(found) == before:
            raise UserError(f"{' and '.join(pair)} have no figure in the same cell; leave one of them out")
    adjusted = holm([as_number(one.pvalue) for one in found])
    return [
        _decided(one, pvalue, figures.metrics[one.figure].better) for one, pvalue in zip(found, adjusted, strict=True)
    ]


def _decided(one: Compared, adjusted: float, better: str) -> Compared:
    ahead = (as_number(one.difference) > 0) == (better == "higher")
    name = (one.first if ahead else one.second) if adjusted <= 1 - CONFIDENCE else ""
    return msgspec.structs.replace(one, holm=as_figure(adjusted), better=name)


def sentences(found: Sequence[Compared], answered: Sequence[Answered] = ()) -> list[str]:
    """Which figures differ and which do not, a line each pair and guide; and whom people prefer."""
    lines: list[str] = []
    for first, second, guide in dict.fromkeys((one.first, one.second, one.guide) for one in found):
        rows = [one for one in found if (one.first, one.second, one.guide) == (first, second, guide)]
        parts = [
            f"{method} is better by {', '.join(names)}"
            for method in (first, second)
            if (names := [one.figure for one in rows if one.better == method])
        ]
        same = [one.figure for one in rows if not one.better]
        if same:
            parts.append(f"they cannot be told apart by {', '.join(same) if parts else 'any figure'}")
        lines.append(f"{first} and {second}, by {guide}s: {'; '.join(parts)}.")
    for one in answered:
        whom = f"people prefer {one.better}" if one.better else "no preference of people is shown"
        lines.append(f"{one.first} and {one.second}, {one.question}: {whom}.")
    return lines


def table(found: Sequence[Compared], figures: Figures, answered: Sequence[Answered] = ()) -> Table:
    """Figures down, and beside them what people prefer, in a block for each pair and guide."""
    better = {name: info.better for name, info in figures.metrics.items()}
    rows: list[tuple[str, ...]] = []
    for first, second, guide in dict.fromkeys((one.first, one.second, one.guide) for one in found):
        rows.append((f"{first} and {second}, by {guide}s",))
        for one in found:
            if (one.first, one.second, one.guide) == (first, second, guide):
                means = [number(as_number(value)) for value in (*one.means, one.difference)]
                rows.append((titled(one.figure, better), *means, *_told(one)))
    for first, second in dict.fromkeys((one.first, one.second) for one in answered):
        rows.append((f"people prefer {first} or {second}",))
        rows += [
            (one.question, "–", "–", number(as_number(one.preference)), *_told(one))
            for one in answered
            if (one.first, one.second) == (first, second)
        ]
    notes = [
        "Differences are of the first and the second method in the cells (or scenes) that both have. Intervals and p "
        "are Student's over crossed random scenes and styles; p is adjusted over all rows by Holm's method, intervals "
        "are not. A method is better where p is at most 0.05. A difference that is the same in every cell has no test."
    ]
    if answered:
        notes.append(
            "Of people: points of the answer scale, above 0 for the first method; adjusted over the questions."
        )
    return Table(
        ("figure", "first", "second", "difference", "95 % interval", "p (Holm)", "better"),
        tuple(rows),
        notes=tuple(notes),
    )


def _told(one: Compared | Answered) -> tuple[str, str, str]:
    low, high, pvalue = (as_number(value) for value in (one.low, one.high, one.holm))
    interval = "–" if math.isnan(low) else f"[{number(low)}, {number(high)}]"
    return interval, "–" if math.isnan(pvalue) else p_text(pvalue).removeprefix("= "), one.better or "–"


def with_people(inputs: Inputs, root: Path, methods: Sequence[str], plan: Sequence[str], out: Path) -> Study:
    """Make a study of two methods' images, of the first seed; ``plan``: words of ``anystyle study design``."""
    known = {spec.name: root / spec.name / "0" for spec in read_methods(root)}
    for method in methods:
        if method not in known:
            raise UserError(unknown("method in these results", method, known))
    for scene in inputs.track.scenes:
        photographs(inputs, scene, root)
    with tempfile.TemporaryDirectory() as name:
        styles = Path(name)
        for style in inputs.track.styles:
            if style.image is None:
                (styles / f"{style.name}.txt").write_text(style.text or "", encoding="utf-8")
            else:
                source = inputs.path(style.image).resolve()
                (styles / f"{style.name}{source.suffix}").symlink_to(source)
        sources = Sources({method: known[method] for method in methods}, methods[0], styles, root / PHOTOGRAPHS)
        return design(sources, read_plan(plan), out)


def answers(source: Path, methods: Sequence[str]) -> list[Answered]:
    """The answers of a study of two of these methods.

    Args:
        source: A study with its answers beside it (``answers.sqlite``, or a folder ``answers``), which are analysed
            into its folder ``analysis``; or what ``anystyle study analyze`` wrote.
        methods: The methods that are compared.
    """
    if (source / "study.json").is_file():
        given = next((path for path in (source / "answers.sqlite", source / "answers") if path.exists()), None)
        if given is None:
            raise UserError(f"the study {source} has no answers beside it (answers.sqlite, or a folder answers)")
        out = source / "analysis"
        words = [str(given), "--study", str(source), "--out", str(out), "--no-report"]
        analyze_command(parse(analyze_parser(), words))
        source = out
    analysis = read_json(source / ANALYSIS if source.is_dir() else source, _Analysis, what="analysis of a study")
    ours, theirs = analysis.settings.ours, analysis.settings.baselines
    if len(theirs) != 1 or not {ours, *theirs} <= set(methods):
        raise UserError(f"{source} is of a study of {ours or '?'} against {', '.join(theirs) or '?'}, not of these two")
    first, second = sorted((ours, *theirs), key=list(methods).index)
    sign = -1 if first == ours else 1  # the study's estimates are below 0 where ours is preferred
    found = []
    for name, question in analysis.questions.items():
        one = question.primary
        if one is not None:
            ends = [sign * as_number(end) for end in (one.estimate, *one.interval)]
            shown = not analysis.checks.doubt and as_number(one.pvalue_holm) <= 1 - CONFIDENCE and ends[0] != 0
            better = (first if ends[0] > 0 else second) if shown else ""
            estimate, low, high = map(as_figure, (ends[0], min(ends[1:]), max(ends[1:])))
            people = question.n_participants
            found.append(
                Answered(first, second, name, estimate, low, high, one.pvalue, one.pvalue_holm, people, better)
            )
    return found


class _Primary(Struct):
    estimate: Figure
    interval: tuple[Figure, Figure]
    pvalue: Figure
    pvalue_holm: Figure


class _Question(Struct):
    n_participants: int
    primary: _Primary | None


class _Settings(Struct):
    ours: str = ""
    baselines: tuple[str, ...] = ()


class _Checks(Struct):
    doubt: str = ""


class _Analysis(Struct):
    settings: _Settings
    checks: _Checks
    questions: dict[str, _Question]
