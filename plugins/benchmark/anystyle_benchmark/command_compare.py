"""``anystyle benchmark compare``: which methods differ, by figures and by people."""

import argparse
from collections.abc import Sequence
from pathlib import Path

import msgspec

from anystyle.cli.arguments import new_parser, parse
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path, write_json
from anystyle_benchmark.compare import answers, compare, sentences, table, with_people
from anystyle_benchmark.judge import inputs_of
from anystyle_benchmark.results import read_figures


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark compare``."""
    flags = new_parser(
        "benchmark compare",
        "Test by which figures methods differ, in the cells that both have.",
        epilog="With --with-people, words such as study=pilot and participants=12 change the study's plan.",
    )
    add = flags.add_argument
    add("results", type=Path, help="a folder that `anystyle benchmark judge` judged")
    add(
        "methods",
        nargs="+",
        metavar="METHOD",
        help="two or more, such as brush nnfm; with --with-people also OPTION=VALUE of the study",
    )
    add("--out", type=Path, metavar="DIR", help="write compare.md and compare.json there")
    add("--with-people", type=Path, metavar="STUDY", help="make a user study of two methods there instead")
    add("--answers", type=Path, metavar="STUDY", help="a study with its answers, or the results of `study analyze`")
    add("--track", metavar="NAME", help="for --with-people: a track, or a track.toml (default: that of the results)")
    add("--root", type=Path, metavar="DIR", help="where the track's inputs lie (default: beside its file)")
    return flags


def main(words: Sequence[str]) -> None:
    """Run ``anystyle benchmark compare``."""
    arguments = parse(parser(), words)
    methods = [word for word in arguments.methods if "=" not in word]
    plan = [word for word in arguments.methods if "=" in word]
    if arguments.with_people is not None:
        if len(methods) != 2:
            raise UserError("a study compares two methods; name two")
        inputs = inputs_of(arguments.results, arguments.track, arguments.root)
        study = with_people(inputs, arguments.results, methods, plan, arguments.with_people)
        out = arguments.with_people
        print(
            f"{' against '.join(methods)}: {len(study.items)} sets for {len(study.participants)} participants, in {out}"
        )
        print(f"next: anystyle study form {out}; what people save goes into {out}/answers, for --answers {out}")
        return
    if plan:
        raise UserError(f"{plan[0]} is an option of a study; it needs --with-people STUDY")
    figures = read_figures(arguments.results)
    found = compare(figures, methods)
    answered = [] if arguments.answers is None else answers(arguments.answers, methods)
    text = "\n".join(
        [table(found, figures, answered).markdown(), *(f"- {line}" for line in sentences(found, answered))]
    )
    print(text)
    if arguments.out is not None:
        document = {"figures": msgspec.to_builtins(found), "people": msgspec.to_builtins(answered)}
        write_json(arguments.out / "compare.json", document)
        with atomic_path(arguments.out / "compare.md") as path:
            path.write_text(text + "\n", encoding="utf-8")
