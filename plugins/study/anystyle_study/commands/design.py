"""``anystyle study design``: from folders of results to a study."""

import argparse
from pathlib import Path

from anystyle.commands._flags import new_parser
from anystyle.errors import UserError
from anystyle_study.commands._options import read_plan
from anystyle_study.design import Sources, design


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study design``."""
    words = new_parser(
        "study design",
        "Draw a study from two or more methods' results, laid out as SCENE/STYLE.png or SCENE/STYLE/*.png: sets "
        "balanced over scenes and styles, positions balanced over participants and sets, orders from Latin squares, "
        "attention checks. Writes study.json, pictures and a report on the balance.",
        epilog="study=paper (the default), study=pilot, study=online or study=FILE.yaml names a plan; words such as "
        "participants=20 change it; anystyle study design --show prints it.",
    )
    add = words.add_argument
    add("options", nargs="*", metavar="OPTION=VALUE", help="changes to the plan")
    add("--method", action="append", default=[], metavar="NAME=FOLDER", help="results; at least twice")
    add("--ours", metavar="NAME", help="the method that the study is about (default: the first)")
    add("--styles", type=Path, metavar="FOLDER", help="STYLE.jpg, or STYLE.txt for styles in words")
    add("--contents", type=Path, metavar="FOLDER", help="SCENE.jpg or SCENE/*.jpg: the photographs")
    add("--out", type=Path, default=Path("study"), help="folder for the study (default: %(default)s)")
    add("--show", action="store_true", help="print the plan and stop")
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
            raise UserError(f"--{name} FOLDER is missing; participants see photograph and style beside the pair")
    methods: dict[str, Path] = {}
    for word in arguments.method:
        name, _, folder = word.partition("=")
        if not (name and folder) or name in methods:
            raise UserError(f"--method {word}: expected NAME=FOLDER, each name once, such as ours=results/ours")
        methods[name] = Path(folder)
    ours = arguments.ours or next(iter(methods), "")
    sources = Sources(methods=methods, ours=ours, styles=arguments.styles, contents=arguments.contents)
    study = design(sources, plan, arguments.out)
    print(
        f"{len(study.items)} sets of {study.ours} against {', '.join(study.baselines)} for {len(study.participants)} "
        f"participants: {arguments.out}/study.json, balance.md, pictures/"
    )
    print(f"next: anystyle study form {arguments.out} --out form.html, or --serve")
