"""The commands of ``anystyle study``."""

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import cache, partial
from pathlib import Path
from typing import Any

import msgspec
from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf

from anystyle.cli.arguments import EPILOG, new_parser, parse, split
from anystyle.cli.launch import job_folder, launch
from anystyle.errors import UserError, of_extra
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import fit
from anystyle.registry.build import build_all
from anystyle.registry.compose import choices, compose
from anystyle_study import figures, report, wording
from anystyle_study.analysis import Analysis, AnalysisOptions, analyze, as_json
from anystyle_study.cells import given_scale, given_words
from anystyle_study.contract import Scale, StudyTest
from anystyle_study.design import Sources, design
from anystyle_study.page import write_page
from anystyle_study.power import Scenario, power_json, power_study, power_table
from anystyle_study.protocol import Plan, Rules, plan_defaults, plan_from, read_study
from anystyle_study.reading import read_responses

CONF = Path(__file__).parent / "conf"


@cache
def _register_plan() -> None:
    """Make the plan's options known to Hydra, with their defaults, before a preset changes them."""
    ConfigStore.instance().store(group="study", name="_plan", node=plan_defaults(), provider="anystyle-study")


def _parser(command: str, description: str, *groups: str) -> argparse.ArgumentParser:
    """A parser of flags, whose help lists what there is to choose from in configuration groups."""
    listing = "".join(f"  {group}: {', '.join(choices(group))}\n" for group in groups)
    flags = new_parser(command, description, f"{EPILOG}Groups:\n{listing}" if groups else None)
    flags.formatter_class = argparse.RawDescriptionHelpFormatter
    return flags


def compose_command(name: str, overrides: Sequence[str] = ()) -> DictConfig:
    """The configuration of ``anystyle study NAME`` with these overrides."""
    _register_plan()
    return compose(f"study_{name}", overrides, conf=CONF)


def plan_of(config: DictConfig) -> Plan:
    """The plan of a composed configuration of ``anystyle study design``."""
    values: Any = OmegaConf.to_container(config.study, resolve=True)
    return plan_from(values)


def design_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study design``; every other word is a Hydra override."""
    flags = _parser(
        "study design",
        "Draw a study from two or more methods' results, laid out as SCENE/STYLE.png or SCENE/STYLE/*.png: sets\n"
        "balanced over scenes and styles, positions balanced over participants and sets, orders from Latin squares,\n"
        "attention checks. Writes study.json, pictures and a report on the balance.",
        "study",
    )
    add = flags.add_argument
    add("--method", action="append", default=[], metavar="NAME=FOLDER", help="results; at least twice")
    add("--ours", metavar="NAME", help="the method that the study is about (default: the first)")
    add("--styles", type=Path, metavar="FOLDER", help="STYLE.jpg, or STYLE.txt for styles in words")
    add("--contents", type=Path, metavar="FOLDER", help="SCENE.jpg or SCENE/*.jpg: the photographs")
    add("--out", type=Path, default=Path("study"), help="folder for the study (default: %(default)s)")
    return flags


def design_job(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Draw a study."""
    plan = plan_of(config)
    for name in ("styles", "contents"):
        if getattr(arguments, name) is None:
            raise UserError(f"--{name} FOLDER is missing; participants see photograph and style beside the pair")
    methods: dict[str, Path] = {}
    for word in arguments.method:
        name, _, folder = word.partition("=")
        if not (name and folder) or name in methods:
            raise UserError(f"--method {word}: expected NAME=FOLDER, each name once, such as ours=results/ours")
        methods[name] = Path(folder)
    ours, out = arguments.ours or next(iter(methods), ""), job_folder(str(arguments.out))
    study = design(Sources(methods, ours, arguments.styles, arguments.contents), plan, out)
    print(
        f"{len(study.items)} sets of {study.compared} for {len(study.participants)} participants: {out}/study.json, "
        f"balance.md, pictures/\n"
        f"next: anystyle study form {out}"
    )


def form_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study form``."""
    flags = _parser(
        "study form",
        "Write the study as one page that works offline, keeps answers in the browser and saves them as JSON.",
    )
    add = flags.add_argument
    add("study", type=Path, help="the folder that `anystyle study design` made")
    add("--out", type=Path, help="the page to write (default: form.html in the study's folder)")
    return flags


def form(words: Sequence[str]) -> None:
    """Run ``anystyle study form``."""
    arguments = parse(form_parser(), words)
    study, folder = read_study(arguments.study), _folder(arguments.study)
    out = arguments.out or folder / "form.html"
    write_page(study, folder, out)
    code = study.participants[0].id
    print(f"{out}: {out.stat().st_size / 1e6:.1f} MB; participants open it and enter their code, or {out.name}#{code}")
    print(f"next: anystyle study analyze ANSWERS... --study {arguments.study} --out analysis")


def _folder(study: Path) -> Path:
    """The folder of a study that is named by it or by its ``study.json``."""
    return study if study.is_dir() else study.parent


def analyze_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study analyze``; every other word is a Hydra override."""
    flags = _parser(
        "study analyze",
        "Read answers (CSV or JSON, one per row), undo the positions, exclude participants by the design's rules and\n"
        "test every question. Writes analysis.json, results.md, results.tex, report.html and figures/.",
        "study_test",
    )
    add = flags.add_argument
    add("responses", nargs="*", type=Path, help="files of answers, or folders of them")
    add("--out", type=Path, default=Path("analysis"), help="folder for the results (default: %(default)s)")
    add("--study", type=Path, help="the designed study, which the form's answers need")
    add("--scale", type=float, nargs=2, metavar=("LOW", "HIGH"), help="answer scale (default: 1 5)")
    labels = "the scale's words from its lowest to its highest answer"
    add("--labels", action="append", nargs="+", default=[], metavar="WORD", help=labels)
    label = "the score of one word, as often as there are words; NA for a missing answer"
    add("--label", action="append", default=[], metavar="WORD=SCORE", help=label)
    wide = "tables may have one row per person, with columns such as S1:style, S1:ours_is"
    add("--wide", action="store_true", help=wide)
    sessions = "people of one name in different files, or sessions (by a column session), are different people"
    add("--sessions", action="store_true", help=sessions)
    key = "table of column, item, question, ours_is (or method): what the columns of a --wide table are about"
    add("--columns", type=Path, metavar="FILE", help=key)
    add("--title", default="User study", help="title of the report")
    add("--confidence", type=float, default=0.95, help="level of all intervals (default: %(default)s)")
    alternative = "of all tests and intervals; less claims that ours is preferred (default: the design's, or two-sided)"
    add("--alternative", choices=("two-sided", "less", "greater"), help=alternative)
    add("--seed", type=int, default=0, help="seed of all resampling (default: %(default)s)")
    way = "fraction of the way from neutral to the end of the scale within which a preference counts as none"
    add("--margin", type=float, metavar="FRACTION", help=f"test for equivalence: {way}")
    add("--failed-checks", type=int, metavar="N", help="attention checks one may fail (default: the design's)")
    add("--exclude-straight-lining", action="store_true", help="exclude participants who gave one answer throughout")
    missing = "fraction of missing answers above which a participant is excluded (default: the design's)"
    add("--missing", type=float, metavar="FRACTION", help=missing)
    add("--no-report", action="store_true", help="neither plots nor page; does not need matplotlib")
    return flags


def analyze_job(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Analyse answers."""
    if not arguments.no_report:
        of_extra("matplotlib", "figures and the report need", "report")
    study = None if arguments.study is None else read_study(arguments.study)
    questions = () if study is None else study.plan.questions
    rules = Rules() if study is None else study.plan.rules
    scale = given_scale(arguments.labels) if arguments.scale is None else Scale(*arguments.scale)
    scales = {} if arguments.scale is not None else {question.name: question.scale for question in questions}
    labels = given_words(arguments.labels, arguments.label, scales.values() or [scale])
    given = {"failed_checks": arguments.failed_checks, "missing_share": arguments.missing}
    given |= {"straight_lining": arguments.exclude_straight_lining or None}
    given = {name: value for name, value in given.items() if value is not None}
    settings = AnalysisOptions(
        scale=scale,
        scales=scales,
        rules=fit(
            msgspec.to_builtins(rules) | given, Rules, source="what --failed-checks and --missing say", what="rule"
        ),
        titles={question.name: question.text.replace("{method}", "A or B") for question in questions},
        study=study,
        alternative=arguments.alternative or ("two-sided" if study is None else study.plan.alternative),
        **{name: getattr(arguments, name) for name in ("confidence", "seed", "margin")},
    )
    common = {name: getattr(settings, name) for name in StudyTest.runtime}
    tests = build_all(StudyTest, config.study_test, **common)
    reading = {name: getattr(arguments, name) for name in ("wide", "columns", "sessions")}
    records = read_responses(arguments.responses, study, labels=labels, **reading)
    analysis = analyze(records, tests, settings, lambda name: print(f"testing {name} …", file=sys.stderr, flush=True))
    out = job_folder(str(arguments.out))
    with atomic_directory(out) as folder:
        _write(analysis, folder, arguments)
    print("\n".join([wording.took_part(analysis), *analysis.checks.notes]))
    for question in analysis.questions:
        print(f"{question.responses.question}: {wording.verdict(analysis, question)}")
    for item in analysis.checks.exclusions:
        print(f"excluded: {item.participant} ({item.rule})")
    print(out / ("analysis.json" if arguments.no_report else "report.html"))


def _write(analysis: Analysis, folder: Path, arguments: argparse.Namespace) -> None:
    texts = {
        "analysis.json": json.dumps(as_json(analysis), indent=1, ensure_ascii=False) + "\n",
        "results.md": report.markdown(analysis),
        "results.tex": report.latex(analysis),
    }
    if not arguments.no_report:
        pictures = None if arguments.study is None else _folder(arguments.study)
        texts["report.html"] = report.html(analysis, arguments.title, pictures)
        (folder / "figures").mkdir()
        for draw in (figures.likert, figures.means):
            figures.save(draw(analysis), folder / "figures" / draw.__name__)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


_SCENARIO = [option for option in fields(Scenario) if "help" in option.metadata]


def power_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study power``; every other word is a Hydra override."""
    flags = _parser(
        "study power",
        "Simulate studies in which participants, sets, scenes and styles differ: power and false-positive rate of\n"
        "each test, and the number of participants it needs. The defaults are the paper's design.",
        "study_test",
    )
    default = "(default: %(default)s)"
    add = flags.add_argument
    add("--participants", type=int, nargs="+", default=[6, 10, 20, 40, 80], help=f"numbers to try {default}")
    for option in _SCENARIO:
        flag, about = f"--{option.name.replace('_', '-')}", f"{option.metadata['help']} {default}"
        add(flag, type=type(option.default), default=option.default, help=about)
    add("--effect", type=float, default=-0.3, help=f"preference in points {default}")
    alternative = f"of the tests; less claims that ours is preferred {default}"
    add("--alternative", choices=("two-sided", "less", "greater"), default="two-sided", help=alternative)
    add("--studies", type=int, default=1000, help=f"simulated studies of each kind {default}")
    add("--level", type=float, default=0.05, help=f"significance level {default}")
    add("--target", type=float, default=0.8, help=f"power to reach {default}")
    add("--seed", type=int, default=0, help=f"seed of the simulation {default}")
    add("--out", type=Path, help="a folder for power.json, power.md and power.pdf/.svg")
    return flags


def power_job(config: DictConfig, arguments: argparse.Namespace) -> None:
    """Simulate studies."""
    if arguments.out is not None:
        of_extra("matplotlib", "figures and the report need", "report")
    study = power_study(
        Scenario(effect=arguments.effect, **{option.name: getattr(arguments, option.name) for option in _SCENARIO}),
        build_all(StudyTest, config.study_test, alternative=arguments.alternative, seed=arguments.seed),
        **{name: getattr(arguments, name) for name in ("participants", "studies", "seed", "level", "target")},
        progress=lambda text: print(f"{text} …", file=sys.stderr, flush=True),
    )
    table = power_table(study).markdown()
    print(table, end="")
    if arguments.out is None:
        return
    out = job_folder(str(arguments.out))
    with atomic_directory(out) as folder:
        (folder / "power.json").write_text(json.dumps(power_json(study), indent=1) + "\n", encoding="utf-8")
        (folder / "power.md").write_text(table, encoding="utf-8")
        figures.save(figures.power(study), folder / "power")
    print(out / "power.svg")


def _composed(name: str, words: Sequence[str]) -> None:
    """Run a command on the configuration that its words compose."""
    flags, job = COMPOSED[name]
    _register_plan()
    arguments, rest = split(flags(), words)
    out = None if arguments.out is None else str(arguments.out)
    launch(f"study_{name}", lambda config: job(config, arguments), rest, CONF, out)


COMPOSED: Mapping[str, tuple[Callable[[], argparse.ArgumentParser], Callable[[DictConfig, argparse.Namespace], None]]]
COMPOSED = {
    "design": (design_parser, design_job),
    "analyze": (analyze_parser, analyze_job),
    "power": (power_parser, power_job),
}
"""The flags of each command whose other words Hydra composes, and what runs it."""
COMMANDS: Mapping[str, Callable[[Sequence[str]], None]] = {
    "form": form,
    **{name: partial(_composed, name) for name in COMPOSED},
}
"""What runs each command on its words."""
