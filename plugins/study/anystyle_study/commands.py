"""The commands of ``anystyle study``."""

import argparse
import inspect
import json
import sys
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import fields
from pathlib import Path
from typing import Any

import msgspec
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from anystyle.cli.arguments import new_parser
from anystyle.errors import UserError, unknown
from anystyle.io.atomic import atomic_directory
from anystyle.io.documents import fit, read_yaml
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import explain
from anystyle.registry.packages import presets
from anystyle_study import figures, report, wording
from anystyle_study.analysis import Analysis, AnalysisOptions, analyze, as_json
from anystyle_study.cells import given_scale, given_words
from anystyle_study.contract import Scale, StudyTest
from anystyle_study.design import Sources, design
from anystyle_study.power import Scenario, power_json, power_study, power_table
from anystyle_study.protocol import Plan, Rules, plan_from, read_study
from anystyle_study.reading import read_responses
from anystyle_study.server import serve, write_page
from anystyle_study.store import Store


def read_plan(overrides: Sequence[str]) -> Plan:
    """The plan that ``study=NAME`` or ``study=FILE`` names (default: ``paper``), changed by ``key=value`` arguments."""
    names = [word for word in overrides if word.startswith("study=")]
    config = names[-1].removeprefix("study=") if names else "paper"
    overrides = [word for word in overrides if word not in names]
    file = Path(config)
    if file.suffix not in (".yaml", ".yml"):
        known = presets("study")
        if config not in known:
            raise UserError(unknown("study configuration", config, known))
        file = known[config]
    options: dict[str, Any] = read_yaml(file, dict[str, Any], what="configuration of 'option: value' lines")
    try:
        merged = OmegaConf.merge(options, OmegaConf.from_dotlist(overrides))
        values: Any = OmegaConf.to_container(merged, resolve=False)
    except (OmegaConfBaseException, YAMLError) as error:
        raise UserError(f"{' '.join(overrides)}: {explain(error)}") from None
    return plan_from(values)


def build_tests(names: Sequence[str], overrides: Sequence[str], common: Mapping[str, Any]) -> dict[str, StudyTest]:
    """Build the named tests, all if none is named; ``common`` options are for every test that has them."""
    options: dict[str, dict[str, Any]] = {name: {} for name in names or catalog().names("study_test")}
    for word in overrides:
        key, equals, value = word.partition("=")
        test, dot, option = key.removeprefix("study_test.").partition(".")
        if not (equals and dot and option):
            raise UserError(f"{word!r} sets no option; expected TEST.OPTION=VALUE, such as wilcoxon.zero_method=pratt")
        if test not in options:
            raise UserError(unknown("test that is run", test, options))
        options[test][option] = OmegaConf.from_dotlist([f"value={value}"]).value
    tests: dict[str, StudyTest] = {}
    for name, given in options.items():
        plugin = catalog().find("study_test", name)
        known = inspect.signature(plugin.load()).parameters
        shared = {option: value for option, value in common.items() if option in known}
        tests[name] = build(StudyTest, {"_target_": plugin.path, **shared, **given})
    return tests


def design_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study design``."""
    flags = new_parser(
        "study design",
        "Draw a study from two or more methods' results, laid out as SCENE/STYLE.png or SCENE/STYLE/*.png: sets "
        "balanced over scenes and styles, positions balanced over participants and sets, orders from Latin squares, "
        "attention checks. Writes study.json, pictures and a report on the balance.",
        epilog="study=paper (the default), study=pilot, study=online or study=FILE.yaml names a plan; arguments such "
        "as participants=20 change it; anystyle study design --show prints it.",
    )
    add = flags.add_argument
    add("options", nargs="*", metavar="OPTION=VALUE", help="changes to the plan")
    add("--method", action="append", default=[], metavar="NAME=FOLDER", help="results; at least twice")
    add("--ours", metavar="NAME", help="the method that the study is about (default: the first)")
    add("--styles", type=Path, metavar="FOLDER", help="STYLE.jpg, or STYLE.txt for styles in words")
    add("--contents", type=Path, metavar="FOLDER", help="SCENE.jpg or SCENE/*.jpg: the photographs")
    add("--out", type=Path, default=Path("study"), help="folder for the study (default: %(default)s)")
    add("--show", action="store_true", help="print the plan and stop")
    return flags


def design_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle study design``."""
    if folders := [word for word in arguments.options if "=" not in word]:
        raise UserError(f"{folders[0]!r} is not an OPTION=VALUE; folders are given with --method NAME=FOLDER")
    plan = read_plan(arguments.options)
    if arguments.show:
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
    ours, out = arguments.ours or next(iter(methods), ""), arguments.out
    study = design(Sources(methods, ours, arguments.styles, arguments.contents), plan, out)
    print(
        f"{len(study.items)} sets of {study.compared} for {len(study.participants)} participants: {out}/study.json, "
        f"balance.md, pictures/\n"
        f"next: anystyle study form {out} --out form.html, or --serve"
    )


def form_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study form``."""
    flags = new_parser(
        "study form",
        "Write the study as one page that works offline, keeps answers in the browser and saves them as JSON at the "
        "end; or serve it, with every answer stored before the next.",
    )
    add = flags.add_argument
    add("study", type=Path, help="the folder that `anystyle study design` made")
    add("--out", type=Path, help="the page to write (default: form.html in the study's folder)")
    add("--serve", action="store_true", help="serve the page instead, until interrupted")
    add("--host", default="127.0.0.1", help="address to serve at; 0.0.0.0 lets other machines in")
    add("--port", type=int, default=8765, help="port to serve at; 0 takes a free one")
    add("--database", type=Path, help="answers when serving (default: answers.sqlite in the folder)")
    add("--release", metavar="ID", help="let this code or id go on in another browser, and stop")
    return flags


def form_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle study form``."""
    study = read_study(arguments.study)
    folder = arguments.study if arguments.study.is_dir() else arguments.study.parent
    database = arguments.database or folder / "answers.sqlite"
    first, last = study.participants[0].id, study.participants[-1].id
    analyze = "next: anystyle study analyze"
    if arguments.release:
        if not database.is_file():
            raise UserError(f"there are no answers at {database}; name the file with --database")
        with closing(Store(study=study, path=database)) as store:
            store.release(arguments.release)
        print(f"{arguments.release} can go on in the browser that asks next")
    elif arguments.serve:
        if not 0 <= arguments.port <= 65535:
            raise UserError(f"--port {arguments.port}: expected 0 to 65535")
        names = study.plan.id_parameters
        query = f"{names[0]}=ID" if names else f"p={first} (codes {first} to {last})"

        def ready(url: str) -> None:
            print(f"serving at {url}?{query}; answers go to {database}", flush=True)

        serve(study, folder, database, host=arguments.host, port=arguments.port, ready=ready)
        print(f"{analyze} {database} --study {arguments.study} --out analysis")
    else:
        out = arguments.out or folder / "form.html"
        write_page(study, folder, out)
        size = out.stat().st_size / 1e6
        print(f"{out}: {size:.1f} MB; participants open it and enter their code, or use {out.name}#{first}")
        print(f"{analyze} ANSWERS... --study {arguments.study} --out analysis")


def analyze_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study analyze``."""
    flags = new_parser(
        "study analyze",
        "Read answers (CSV, JSON or SQLite, one per row), undo the positions, exclude participants by the design's "
        "rules and test every question. Writes analysis.json, results.md, results.tex, report.html and figures/.",
        epilog="Arguments such as wilcoxon.zero_method=pratt set a test's options; see anystyle plugins study_test.",
    )
    add = flags.add_argument
    add("responses", nargs="+", help="files of answers, or folders of them; and TEST.OPTION=VALUE")
    add("--out", type=Path, required=True, help="folder for the results")
    add("--study", type=Path, help="the designed study, which the form's answers need")
    add("--scale", type=float, nargs=2, metavar=("LOW", "HIGH"), help="answer scale (default: 1 5)")
    labels = "the scale's words from its lowest to its highest answer, or WORD=SCORE; WORD=NA for a missing answer"
    add("--labels", action="append", nargs="+", default=[], metavar="WORD", help=labels)
    wide = "tables may have one row per person, with columns such as S1:style, S1:ours_is"
    add("--wide", action="store_true", help=wide)
    key = "table of column, item, question, ours_is (or method): what the columns of a --wide table are about"
    add("--columns", type=Path, metavar="FILE", help=key)
    add("--test", action="append", default=[], metavar="NAME", help="run only these tests")
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


def analyze_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle study analyze``."""
    if not arguments.no_report:
        figures.require_matplotlib()
    study = None if arguments.study is None else read_study(arguments.study)
    questions = () if study is None else study.plan.questions
    rules = Rules() if study is None else study.plan.rules
    scale = given_scale(arguments.labels) if arguments.scale is None else Scale(*arguments.scale)
    scales = {} if arguments.scale is not None else {question.name: question.scale for question in questions}
    labels = given_words(arguments.labels, scales.values() or [scale])
    given = {"failed_checks": arguments.failed_checks, "missing_share": arguments.missing}
    given |= {"straight_lining": arguments.exclude_straight_lining or None}
    given = {name: value for name, value in given.items() if value is not None}
    settings = AnalysisOptions(
        scale=scale,
        scales=scales,
        rules=fit(msgspec.to_builtins(rules) | given, Rules, source="--missing", what="rule"),
        titles={question.name: question.text.replace("{method}", "A or B") for question in questions},
        study=study,
        alternative=arguments.alternative or ("two-sided" if study is None else study.plan.alternative),
        **{name: getattr(arguments, name) for name in ("confidence", "seed", "margin")},
    )
    files = [word for word in arguments.responses if Path(word).exists() or "=" not in word]
    overrides = [word for word in arguments.responses if word not in files]
    common = {name: getattr(settings, name) for name in ("confidence", "alternative", "seed")}
    tests = build_tests(arguments.test, overrides, common)
    records = read_responses(map(Path, files), study, labels=labels, wide=arguments.wide, columns=arguments.columns)
    analysis = analyze(records, tests, settings, lambda name: print(f"testing {name} …", file=sys.stderr, flush=True))
    with atomic_directory(arguments.out) as folder:
        _write(analysis, folder, arguments)
    print(wording.took_part(analysis))
    for question in analysis.questions:
        print(f"{question.responses.question}: {wording.verdict(analysis, question)}")
    for item in analysis.checks.exclusions:
        print(f"excluded: {item.participant} ({item.rule})")
    print(arguments.out / ("analysis.json" if arguments.no_report else "report.html"))


def _write(analysis: Analysis, folder: Path, arguments: argparse.Namespace) -> None:
    texts = {
        "analysis.json": json.dumps(as_json(analysis), indent=1, ensure_ascii=False) + "\n",
        "results.md": report.markdown(analysis),
        "results.tex": report.latex(analysis),
    }
    if not arguments.no_report:
        study: Path | None = arguments.study
        pictures = study if study is None or study.is_dir() else study.parent
        texts["report.html"] = report.html(analysis, arguments.title, pictures)
        (folder / "figures").mkdir()
        for draw in (figures.likert, figures.means):
            figures.save(draw(analysis), folder / "figures" / draw.__name__)
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")


_POWER_TESTS = ["one_sample_t", "wilcoxon", "crossed_t"]
_SCENARIO = [option for option in fields(Scenario) if "help" in option.metadata]


def power_parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study power``."""
    flags = new_parser(
        "study power",
        "Simulate studies in which participants, sets, scenes and styles differ: power and false-positive rate of each "
        "test, and the number of participants it needs. The defaults are the paper's design.",
    )
    default = "(default: %(default)s)"
    add = flags.add_argument
    add("options", nargs="*", metavar="TEST.OPTION=VALUE", help="options of the tests")
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
    add("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    add("--out", type=Path, help="a folder for power.json, power.md and power.pdf/.svg")
    return flags


def power_command(arguments: argparse.Namespace) -> None:
    """Run ``anystyle study power``."""
    if arguments.out is not None:
        figures.require_matplotlib()
    common = {"alternative": arguments.alternative, "seed": arguments.seed}
    tests = build_tests(arguments.test or _POWER_TESTS, arguments.options, common)
    study = power_study(
        Scenario(effect=arguments.effect, **{option.name: getattr(arguments, option.name) for option in _SCENARIO}),
        tests,
        **{name: getattr(arguments, name) for name in ("participants", "studies", "seed", "level", "target")},
        progress=lambda text: print(f"{text} …", file=sys.stderr, flush=True),
    )
    table = power_table(study).markdown()
    print(table, end="")
    if arguments.out is None:
        return
    with atomic_directory(arguments.out) as folder:
        (folder / "power.json").write_text(json.dumps(power_json(study), indent=1) + "\n", encoding="utf-8")
        (folder / "power.md").write_text(table, encoding="utf-8")
        figures.save(figures.power(study), folder / "power")
    print(arguments.out / "power.svg")


COMMANDS = {
    "design": (design_parser, design_command),
    "form": (form_parser, form_command),
    "analyze": (analyze_parser, analyze_command),
    "power": (power_parser, power_command),
}
"""The flags of each command, and what runs it."""
