"""``anystyle benchmark people``: which metrics order methods as the participants of a study do."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec

from anystyle.cli.arguments import new_parser, parse
from anystyle.evaluation.tables import STAND_IN, Table, titled
from anystyle.io.atomic import atomic_path, write_json
from anystyle.io.documents import Figure, as_number
from anystyle_benchmark.people import OTHERS, People, correlated
from anystyle_benchmark.results import read_figures
from anystyle_benchmark.templates import templates
from anystyle_study.wording import generalization, p_text


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark people``."""
    flags = new_parser(
        "benchmark people",
        "For each metric and question its rank correlation with the answers of a study of the results' methods. Writes "
        "people.json, people.md, people.csv and people.svg.",
        epilog="anystyle benchmark compare RESULTS METHOD METHOD METHOD --with-people STUDY makes such a study.",
    )
    add = flags.add_argument
    add("results", type=Path, help="a folder that `anystyle benchmark judge` judged, or its figures.json")
    add("study", type=Path, help="the study with its answers (answers.sqlite, or a folder answers)")
    add("--out", type=Path, metavar="DIR", help="where to write (default: the study's folder)")
    return flags


def main(args: Sequence[str]) -> None:
    """Run ``anystyle benchmark people``."""
    arguments = parse(parser(), args)
    people = correlated(read_figures(arguments.results), arguments.study)
    out, listed = arguments.out or arguments.study, table(people)
    write_json(out / "people.json", msgspec.to_builtins(people))
    texts = {"people.md": listed.markdown(), "people.csv": listed.csv(), "people.svg": picture(people)}
    for name, text in texts.items():
        with atomic_path(out / name) as path:
            path.write_text(text, encoding="utf-8")
    print(f"{texts['people.md']}\nin {out}: people.json, {', '.join(texts)}")


def table(people: People) -> Table:
    """Figures down, in a block for each question, after the agreement of the participants with each other."""
    better = {name: info.better for name, info in people.metrics.items()}
    stand_ins = {name: info.stand_in for name, info in people.metrics.items() if info.stand_in}
    rows: list[tuple[str, ...]] = []
    for others in people.others:
        rows.append((others.question,))
        for one in (others, *(one for one in people.figures if one.question == others.question)):
            name = titled(one.figure, better) + "†" * (one.figure in stand_ins)
            pvalue = "–" if one.holm is None else p_text(as_number(one.holm)).removeprefix("= ")
            agrees = "–" if one.agrees is None else f"{as_number(one.agrees):.0%}".replace("%", " %")
            values = _decimals(one.d), _bounds(one.low, one.high), pvalue, agrees, _bounds(*one.without)
            rows.append((name, *values, str(one.pairs), str(one.ties)))
    claims = dict.fromkeys(generalization(one.generalizes_to) for one in people.figures)
    notes = (
        "Somers' D: of the pairs in which a participant prefers a method, the share in which the score prefers the "
        "same one, less that in which it prefers the other (Kendall's tau where the score has no ties). Agrees: "
        f"(1 + D) / 2. {OTHERS.capitalize()}: what most of them prefer in the same pair, a lower bound of what a score "
        "can reach.",
        f"Intervals and p are Student's over crossed factors, for {'; or '.join(claims)}, and for these methods "
        f"({', '.join(people.methods)}): with one of them left out D lies within the bounds beside it. p is adjusted "
        "over the scores of a question by Holm's method.",
        f"Track {people.track.name} {people.track.version}, study {people.study}.",
        *(f"† {name}: {network} ({STAND_IN})." for name, network in stand_ins.items()),
        *people.notes,
    )
    columns = ("score", "Somers' D", "95 % interval", "p (Holm)", "agrees", "D without a method", "pairs", "ties")
    return Table(columns, tuple(rows), notes=notes)


def _decimals(value: Figure) -> str:
    return "–" if value is None else f"{as_number(value):+.2f}".replace("-", "−")


def _bounds(low: Figure, high: Figure) -> str:
    return "–" if low is None else f"[{_decimals(low)}, {_decimals(high)}]"


def picture(people: People) -> str:
    """Somers' D of every figure with its interval as an SVG picture, a panel for each question."""
    found = {(one.question, one.figure): one for one in people.figures}
    values = {"people": people, "found": found, "decimals": _decimals, "bounds": _bounds}
    return templates().get_template("people.svg").render(values)
