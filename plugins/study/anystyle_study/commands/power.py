"""``anystyle study power``: what a study of some size would find."""

import argparse
import json
import sys
from dataclasses import fields
from pathlib import Path
from typing import Any

from anystyle.commands._flags import new_parser
from anystyle.io.atomic import atomic_directory
from anystyle_study import figures
from anystyle_study.commands._options import build_tests
from anystyle_study.power import Scenario, power_json, power_study, power_table

DEFAULT_TESTS = ("one_sample_t", "wilcoxon", "crossed_t")
_SCENARIO = {
    "items": "sets that each participant judges",
    "scenes": "number of scenes",
    "styles": "number of styles",
    "pool": "sets in all, of which each participant judges a part; 0 for all",
    "participant_sd": "SD between participants",
    "item_sd": "SD between sets",
    "scene_sd": "SD between scenes",
    "style_sd": "SD between styles",
    "residual_sd": "SD between single answers",
}


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study power``."""
    words = new_parser(
        "study power",
        "Simulate studies in which participants, sets, scenes and styles differ: power and false-positive rate of each "
        "test, and the number of participants it needs. The defaults are the paper's design.",
    )
    add = words.add_argument
    add("options", nargs="*", metavar="TEST.OPTION=VALUE", help="options of the tests")
    numbers = [6, 10, 20, 40, 80]
    add("--participants", type=int, nargs="+", default=numbers, help="numbers to try (default: %(default)s)")
    for name, text in _SCENARIO.items():
        default = getattr(Scenario(), name)
        add(f"--{name.replace('_', '-')}", type=type(default), default=default, help=f"{text} (default: %(default)s)")
    add("--effect", type=float, default=-0.3, help="preference in points (default: %(default)s)")
    alternative = "of the tests; less claims that ours is preferred (default: %(default)s)"
    add("--alternative", choices=("two-sided", "less", "greater"), default="two-sided", help=alternative)
    add("--studies", type=int, default=1000, help="simulated studies of each kind (default: %(default)s)")
    add("--level", type=float, default=0.05, help="significance level (default: %(default)s)")
    add("--target", type=float, default=0.8, help="power to reach (default: %(default)s)")
    add("--seed", type=int, default=0, help="seed of the simulation (default: %(default)s)")
    add("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    add("--out", type=Path, help="a folder for power.json, power.md and power.pdf/.svg")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if arguments.out is not None:
        figures.require_matplotlib()
    common = {"alternative": arguments.alternative, "seed": arguments.seed}
    tests = build_tests(arguments.test or list(DEFAULT_TESTS), arguments.options, common)
    given: dict[str, Any] = vars(arguments) | {"participants": max(arguments.participants, default=1)}
    study = power_study(
        Scenario(**{field.name: given[field.name] for field in fields(Scenario) if field.name in given}),
        tests,
        participants=arguments.participants,
        **{name: given[name] for name in ("studies", "seed", "level", "target")},
        progress=lambda text: print(f"{text} …", file=sys.stderr, flush=True),
    )
    table = power_table(study).markdown()
    print(table, end="")
    if arguments.out is None:
        return
    with atomic_directory(arguments.out) as folder:
        (folder / "power.json").write_text(json.dumps(power_json(study), indent=1) + "\n", encoding="utf-8")
        (folder / "power.md").write_text(table, encoding="utf-8")
        for suffix in ("pdf", "svg"):
            figures.save(figures.power(study), folder / f"power.{suffix}")
    print(arguments.out / "power.svg")
