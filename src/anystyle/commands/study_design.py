"""``anystyle study design``: from folders of results to a study."""

import argparse
from pathlib import Path

from anystyle.commands._flags import new_parser
from anystyle.commands._study_options import read_plan
from anystyle.errors import UserError
from anystyle.study.design import Sources, design


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle study design``."""
    words = new_parser(
        "study design",
        "Draw a study from two or more methods' results, laid out as SCENE/STYLE.png or SCENE/STYLE/*.png: "
        "sets balanced over scenes and styles, positions balanced over participants and sets, orders from Latin "
        "squares, attention checks; of a larger pool, each one sees a balanced part. Writes study.json, pictures "
        "and a report on the balance.",
        epilog="study=paper (the default), study=pilot, study=online or study=FILE.yaml says what is asked; words "
        "such as participants=20 change it; anystyle study design --show prints it.",
    )
    words.add_argument("options", nargs="*", metavar="OPTION=VALUE", help="changes to the configuration")
    words.add_argument("--method", action="append", default=[], metavar="NAME=FOLDER", help="results; at least twice")
    words.add_argument("--ours", metavar="NAME", help="which method the study is about (default: the first)")
    words.add_argument("--styles", type=Path, metavar="FOLDER", help="STYLE.jpg, or STYLE.txt for styles in words")
    words.add_argument("--contents", type=Path, metavar="FOLDER", help="SCENE.jpg or SCENE/*.jpg: the photographs")
    words.add_argument("--out", type=Path, default=Path("study"), help="where the study goes (default: %(default)s)")
    words.add_argument("--show", action="store_true", help="print the options and stop")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    for word in arguments.options:
        if "=" not in word:
            raise UserError(f"{word!r} is no OPTION=VALUE; folders are given with --method NAME=FOLDER")
    plan = read_plan(arguments.options)
    if arguments.show:
        import msgspec
        from omegaconf import OmegaConf

        print(OmegaConf.to_yaml(OmegaConf.create(msgspec.to_builtins(plan))), end="")
        return
    for name in ("styles", "contents"):
        if getattr(arguments, name) is None:
            raise UserError(
                f"--{name} FOLDER is missing; participants see the photograph and the style beside the pair"
            )
    methods = dict(_method(word) for word in arguments.method)
    if len(methods) < len(arguments.method):
        raise UserError("a method is given twice; every --method needs a name of its own")
    ours = arguments.ours or next(iter(methods), "")
    sources = Sources(methods=methods, ours=ours, styles=arguments.styles, contents=arguments.contents)
    study = design(sources, plan, arguments.out)
    print(
        f"{len(study.items)} sets of {study.ours} against {', '.join(study.baselines)} for {len(study.participants)} "
        f"participants: {arguments.out}/study.json, balance.md, pictures/"
    )
    print(f"next: anystyle study form {arguments.out} --out form.html, or --serve")


def _method(word: str) -> tuple[str, Path]:
    name, equals, folder = word.partition("=")
    if not (name and equals and folder):
        raise UserError(f"--method {word}: expected NAME=FOLDER, such as --method ours=results/ours")
    return name, Path(folder)
