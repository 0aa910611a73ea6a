"""``anystyle benchmark compare``: which methods differ, by which scores, and which of them people prefer."""

import argparse
import math
import tempfile
from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
from msgspec import Struct

from anystyle.cli.arguments import new_parser, parse
from anystyle.errors import UserError, unknown
from anystyle.evaluation.tables import Table, number, titled
from anystyle.io.atomic import atomic_path, write_json
from anystyle.io.documents import Figure, as_figure, as_number, read_json
from anystyle_benchmark.judge import GUIDES, PHOTOGRAPHS, inputs_of, photographs, read_methods
from anystyle_benchmark.people import IMAGES, answers_in, named
from anystyle_benchmark.results import Figures, cells_of, images_hash, is_done, read_figures
from anystyle_benchmark.statistics import CONFIDENCE, arranged, difference
from anystyle_benchmark.track import Inputs
from anystyle_study.commands import analyze_command, analyze_parser, read_plan
from anystyle_study.design import Sources, design
from anystyle_study.protocol import Study
from anystyle_study.statistics import holm
from anystyle_study.wording import p_text

STUDIED = ("branch", "brush", "palette_transfer", "sos", "tiny_paper_taught", "two_d")
"""What a study shows if no methods are named: one of each family, and no baseline, which any metric tells apart."""


class Compared(Struct, frozen=True):
    """A figure of two methods in the ``n`` cells (or scenes) that both have: means, and first minus second.

    The 95 % interval is for new scenes and styles, ``holm`` the two-sided ``pvalue`` adjusted over all figures, guides
    and pairs; ``None`` where there are too few to say. ``better`` is empty where the two cannot be told apart.
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


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark compare``."""
    flags = new_parser(
        "benchmark compare",
        "Test by which figures methods differ, in the cells that both have.",
        epilog="With --with-people, arguments such as study=pilot and participants=12 change the study's plan; of more "
        "than two methods every pair is shown (study=benchmark).",
    )
    add = flags.add_argument
    add("results", type=Path, help="a folder that `anystyle benchmark judge` judged")
    methods = f"two or more (with --with-people, by default {' '.join(STUDIED)}); and OPTION=VALUE of a study"
    add("methods", nargs="*", metavar="METHOD", help=methods)
    add("--out", type=Path, metavar="DIR", help="write compare.md and compare.json there")
    add("--with-people", type=Path, metavar="STUDY", help="make a user study of the methods there instead")
    add("--answers", type=Path, metavar="STUDY", help="a study with its answers, or the results of `study analyze`")
    add("--track", metavar="NAME", help="for --with-people: a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark compare``."""
    arguments = parse(parser(), args)
    methods = [word for word in arguments.methods if "=" not in word]
    plan = [word for word in arguments.methods if "=" in word]
    if (out := arguments.with_people) is not None:
        methods = methods or list(STUDIED)
        if len(methods) < 2:
            raise UserError("a study compares methods; name two or more")
        inputs = inputs_of(arguments.results, arguments.track, arguments.root)
        study = with_people(inputs, arguments.results, methods, plan, out)
        print(f"{study.compared}: {len(study.items)} sets for {len(study.participants)} participants, in {out}")
        then = f"--answers {out}" if len(methods) == 2 else f"anystyle benchmark people {arguments.results} {out}"
        print(f"next: anystyle study form {out}; what people save goes into {out}/answers, for {then}")
        return
    if plan:
        raise UserError(f"{plan[0]} is an option of a study; it needs --with-people STUDY")
    figures = read_figures(arguments.results)
    found = compare(figures, methods)
    answered = [] if arguments.answers is None else answers(arguments.answers, methods)
    lines = [table(found, figures, answered).markdown(), *(f"- {line}" for line in sentences(found, answered))]
    print(text := "\n".join(lines))
    if arguments.out is not None:
        document = {"figures": msgspec.to_builtins(found), "people": msgspec.to_builtins(answered)}
        write_json(arguments.out / "compare.json", document)
        with atomic_path(arguments.out / "compare.md") as path:
            path.write_text(text + "\n", encoding="utf-8")


def compare(figures: Figures, methods: Sequence[str]) -> list[Compared]:
    """Every figure of every two methods."""
    if len(set(methods)) != len(methods) or len(methods) < 2:
        raise UserError("name two methods or more, each once")
    _known(methods, figures.methods)
    rows = [*figures.cells, *figures.scenes]
    found: list[Compared] = []
    for pair in combinations(methods, 2):
        before = len(found)
        for guide in GUIDES:
            groups = [[row for row in rows if (row.method, row.guide) == (method, guide)] for method in pair]
            for figure in figures.metrics:
                first, second = arranged(figure, *groups)
                both = ~np.isnan(first) & ~np.isnan(second)
                if both.any():
                    gap = difference(first, second)
                    mean, low, high, pvalue = map(as_figure, gap[:4])
                    means = as_figure(float(first[both].mean())), as_figure(float(second[both].mean()))
                    found.append(Compared(*pair, guide, figure, means, mean, low, high, pvalue, None, gap.n))
        if len(found) == before:
            raise UserError(f"{' and '.join(pair)} have no figure in the same cell; leave one of them out")
    adjusted = holm([as_number(one.pvalue) for one in found])
    return [
        _decided(one, pvalue, figures.metrics[one.figure].better) for one, pvalue in zip(found, adjusted, strict=True)
    ]


def _known(methods: Sequence[str], known: Sequence[str] | dict[str, Any]) -> None:
    for method in methods:
        if method not in known:
            raise UserError(unknown("method in these results", method, known))


def _decided(one: Compared, adjusted: float, better: str) -> Compared:
    ahead = (as_number(one.difference) > 0) == (better == "higher")
    name = (one.first if ahead else one.second) if adjusted <= 1 - CONFIDENCE else ""
    return msgspec.structs.replace(one, holm=as_figure(adjusted), better=name)


def _blocks(found: Sequence[Compared]) -> dict[tuple[str, str, str], list[Compared]]:
    """The rows of each pair and guide."""
    blocks: dict[tuple[str, str, str], list[Compared]] = {}
    for one in found:
        blocks.setdefault((one.first, one.second, one.guide), []).append(one)
    return blocks


def sentences(found: Sequence[Compared], answered: Sequence[Answered] = ()) -> list[str]:
    """Which figures differ and which do not, a line for each pair and guide; and whom people prefer."""
    lines: list[str] = []
    for (first, second, guide), rows in _blocks(found).items():
        better = {method: [one.figure for one in rows if one.better == method] for method in (first, second)}
        parts = [f"{method} is better by {', '.join(names)}" for method, names in better.items() if names]
        if same := [one.figure for one in rows if not one.better]:
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
    for (first, second, guide), block in _blocks(found).items():
        rows.append((f"{first} and {second}, by {guide}s",))
        for one in block:
            means = [number(as_number(value)) for value in (*one.means, one.difference)]
            rows.append((titled(one.figure, better), *means, *_told(one)))
    if answered:
        rows.append((f"people prefer {answered[0].first} or {answered[0].second}",))
    rows += [(one.question, "–", "–", number(as_number(one.preference)), *_told(one)) for one in answered]
    notes = [
        "Differences are of the first and the second method in the cells (or scenes) that both have. Intervals and p "
        "are Student's over crossed random scenes and styles; p is adjusted over all rows by Holm's method, intervals "
        "are not. A method is better where p is at most 0.05. A difference that is the same in every cell has no test."
    ]
    people = "Of people: points of the answer scale, above 0 for the first method; adjusted over the questions."
    columns = ("figure", "first", "second", "difference", "95 % interval", "p (Holm)", "better")
    return Table(columns, tuple(rows), notes=(*notes, *([people] if answered else [])))


def _told(one: Compared | Answered) -> tuple[str, str, str]:
    low, high, pvalue = (as_number(value) for value in (one.low, one.high, one.holm))
    interval = "–" if math.isnan(low) else f"[{number(low)}, {number(high)}]"
    return interval, "–" if math.isnan(pvalue) else p_text(pvalue).removeprefix("= "), one.better or "–"


def with_people(inputs: Inputs, root: Path, methods: Sequence[str], plan: Sequence[str], out: Path) -> Study:
    """Make a study of methods' images, of the first seed; ``plan``: arguments of ``anystyle study design``.

    Of more than two methods every pair is shown, by default in the study ``benchmark``. ``images.json`` has the hashes
    of all images of the methods.
    """
    if len(methods) > 2:
        plan = ["study=benchmark", "pairs=all", *plan]
    _known(methods, [spec.name for spec in read_methods(root)])
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
        folders = {method: root / method / "0" for method in methods}
        study = design(Sources(folders, methods[0], styles, root / PHOTOGRAPHS), read_plan(plan), out)
    cells = (cell for method in methods for cell in cells_of(root, method) if cell.seed == 0 and is_done(cell, root))
    hashes = {named(cell): images_hash(cell, root, inputs.scene(cell.scene).views) for cell in cells}
    write_json(out / IMAGES, hashes)
    return study


class _Primary(Struct):
    estimate: Figure
    interval: tuple[Figure, Figure]
    pvalue: Figure
    pvalue_holm: Figure


class _Question(Struct):
    n_participants: int
    primary: _Primary | None


class _Analysis(Struct):
    """What is read of ``analysis.json``."""

    settings: dict[str, Any]
    checks: dict[str, Any]
    questions: dict[str, _Question]


def answers(source: Path, methods: Sequence[str]) -> list[Answered]:
    """The answers of a study of two of these methods.

    Args:
        source: A study with its answers beside it (``answers.sqlite``, or a folder ``answers``), which are analysed
            into its folder ``analysis``; or what ``anystyle study analyze`` wrote.
        methods: The methods that are compared.
    """
    if (source / "study.json").is_file():
        args = [str(answers_in(source)), "--study", str(source), "--out", str(source / "analysis"), "--no-report"]
        analyze_command(parse(analyze_parser(), args))
        source = source / "analysis"
    file = source / "analysis.json" if source.is_dir() else source
    analysis: _Analysis = read_json(file, _Analysis, what="analysis of a study")
    ours, theirs = analysis.settings.get("ours", "?"), analysis.settings.get("baselines", ["?"])
    if len(theirs) != 1 or not {ours, *theirs} <= set(methods):
        raise UserError(
            f"{source} is of a study of {ours} against {', '.join(theirs)}, not of two of these methods; anystyle "
            "benchmark people reads studies of more"
        )
    first, second = sorted((ours, *theirs), key=list(methods).index)
    sign = -1 if first == ours else 1  # the study's estimates are below 0 where ours is preferred
    found = []
    for name, question in analysis.questions.items():
        if (one := question.primary) is not None:
            mean, *ends = (sign * as_number(end) for end in (one.estimate, *one.interval))
            shown = not analysis.checks.get("doubt") and as_number(one.pvalue_holm) <= 1 - CONFIDENCE and mean != 0
            better = (first if mean > 0 else second) if shown else ""
            estimate, low, high = map(as_figure, (mean, min(ends), max(ends)))
            tested = one.pvalue, one.pvalue_holm, question.n_participants
            found.append(Answered(first, second, name, estimate, low, high, *tested, better))
    return found
