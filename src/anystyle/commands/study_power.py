"""``anystyle study power``: what a study of some size would find."""

import argparse
import json
import sys
from dataclasses import fields
from pathlib import Path

from anystyle.commands._flags import new_parser
from anystyle.commands._study_options import build_tests
from anystyle.io.atomic import atomic_directory
from anystyle.study import figures
from anystyle.study.figures import power
from anystyle.study.power import Scenario, power_json, power_markdown, power_study

DEFAULT_TESTS = ("one_sample_t", "wilcoxon", "crossed_t")


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle study power``."""
    scenario = Scenario()
    words = new_parser(
        "study power",
        "Simulate studies with differences between participants, sets, scenes and styles: how often each "
        "test finds a preference that is there and one that is not, and how many participants it needs. The defaults "
        "are the paper's design.",
    )
    words.add_argument("options", nargs="*", metavar="TEST.OPTION=VALUE", help="options of the tests")
    words.add_argument(
        "--participants", type=int, nargs="+", default=[6, 10, 20, 40, 80], help="numbers to try (default: %(default)s)"
    )
    for name, text in (
        ("items", "sets each one judges"),
        ("scenes", "scenes of the sets"),
        ("styles", "styles of the sets"),
        ("pool", "sets in all, of which each one judges a part; 0 for all"),
    ):
        default = getattr(scenario, name)
        words.add_argument(f"--{name}", type=int, default=default, help=f"{text} (default: %(default)s)")
    words.add_argument("--effect", type=float, default=-0.3, help="preference in points (default: %(default)s)")
    for name, text in (
        ("participant", "participants"),
        ("item", "sets"),
        ("scene", "scenes"),
        ("style", "styles"),
        ("residual", "single answers"),
    ):
        default = getattr(scenario, f"{name}_sd")
        words.add_argument(
            f"--{name}-sd", type=float, default=default, help=f"SD between {text} (default: %(default)s)"
        )
    words.add_argument(
        "--alternative",
        choices=("two-sided", "less", "greater"),
        default="two-sided",
        help="of the tests; less claims that ours is preferred (default: %(default)s)",
    )
    words.add_argument("--studies", type=int, default=1000, help="simulated, of each kind (default: %(default)s)")
    words.add_argument("--level", type=float, default=0.05, help="of the tests (default: %(default)s)")
    words.add_argument("--target", type=float, default=0.8, help="the power to reach (default: %(default)s)")
    words.add_argument("--seed", type=int, default=0, help="of the simulation (default: %(default)s)")
    words.add_argument("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    words.add_argument("--out", type=Path, help="a folder for power.json, power.md and power.pdf/.svg")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if arguments.out is not None:
        figures.require()
    common = {"alternative": arguments.alternative, "seed": arguments.seed}
    tests = build_tests(arguments.test or list(DEFAULT_TESTS), arguments.options, common)
    options = {
        field.name: getattr(arguments, field.name) for field in fields(Scenario) if field.name in vars(arguments)
    }
    scenario = Scenario(**{**options, "participants": max(arguments.participants, default=1)})
    study = power_study(
        scenario,
        tests,
        participants=arguments.participants,
        studies=arguments.studies,
        seed=arguments.seed,
        level=arguments.level,
        target=arguments.target,
        progress=lambda text: print(f"{text} …", file=sys.stderr, flush=True),
    )
    print(power_markdown(study), end="")
    if arguments.out is None:
        return
    with atomic_directory(arguments.out) as folder:
        (folder / "power.json").write_text(json.dumps(power_json(study), indent=1) + "\n", encoding="utf-8")
        (folder / "power.md").write_text(power_markdown(study), encoding="utf-8")
        for suffix in ("pdf", "svg"):
            figures.save(power(study), folder / f"power.{suffix}")
    print(arguments.out / "power.svg")
