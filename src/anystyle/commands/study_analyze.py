"""``anystyle study analyze``: from answers to tests, tables, figures and a report."""

import argparse
import json
import sys
from pathlib import Path

from msgspec import structs

from anystyle.commands._flags import new_parser
from anystyle.commands._study_options import build_tests
from anystyle.io.atomic import atomic_directory
from anystyle.study import figures, report
from anystyle.study.analysis import Analysis, Settings, analyze, as_json
from anystyle.study.contract import Scale
from anystyle.study.protocol import Rules, read_study
from anystyle.study.reading import read_responses
from anystyle.study.report import latex, markdown
from anystyle.study.verdicts import took_part, verdict


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle study analyze``."""
    words = new_parser(
        "study analyze",
        "Read answers (CSV, JSON or SQLite, one a row), undo the positions, leave out whom the design's "
        "rules say, and test every question for new participants, scenes and styles. Writes analysis.json, results.md, "
        "results.tex, report.html and figures/.",
        epilog="Words such as wilcoxon.zero_method=pratt set a test's options; anystyle plugins study_test lists them.",
    )
    words.add_argument("responses", nargs="+", help="files of answers, or folders of them; and TEST.OPTION=VALUE")
    words.add_argument("--out", type=Path, required=True, help="where the results go")
    words.add_argument("--study", type=Path, help="the designed study, which the form's answers need")
    words.add_argument("--scale", type=float, nargs=2, metavar=("LOW", "HIGH"), help="the answer scale (default: 1 5)")
    words.add_argument("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    words.add_argument("--title", default="User study", help="of the report")
    words.add_argument("--confidence", type=float, default=0.95, help="of all intervals (default: %(default)s)")
    words.add_argument(
        "--alternative",
        choices=("two-sided", "less", "greater"),
        default="two-sided",
        help="of all tests and intervals; less claims that ours is preferred (default: %(default)s)",
    )
    words.add_argument("--seed", type=int, default=0, help="of all resampling (default: %(default)s)")
    words.add_argument(
        "--margin", type=float, metavar="SHARE", help="of the way from neutral to the scale's end, within which a "
        "preference counts as none: asks for equivalence"
    )  # fmt: skip
    words.add_argument(
        "--failed-checks", type=int, metavar="N", help="attention checks a participant may fail (default: the design's)"
    )
    words.add_argument(
        "--exclude-straight-lining", action="store_true", help="leave out who gave one answer throughout"
    )
    words.add_argument(
        "--missing",
        type=float,
        metavar="SHARE",
        help="of assigned answers missing that excludes (default: the design's)",
    )
    words.add_argument("--no-report", action="store_true", help="no figures and no page: needs no matplotlib")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if not arguments.no_report:
        figures.require()
    settings = _settings(arguments)
    files = [word for word in arguments.responses if Path(word).exists() or "=" not in word]
    overrides = [word for word in arguments.responses if word not in files]
    common = {"confidence": settings.confidence, "alternative": settings.alternative, "seed": settings.seed}
    tests = build_tests(arguments.test, overrides, common)
    records = read_responses([Path(word) for word in files], settings.study)
    analysis = analyze(records, tests, settings, progress=_tell)
    with atomic_directory(arguments.out) as folder:
        _write(analysis, folder, arguments)
    print(took_part(analysis))
    for question in analysis.questions:
        print(f"{question.question}: {verdict(analysis, question)}")
    for item in analysis.checks.exclusions:
        print(f"left out: {item.participant} ({item.rule})")
    print(f"{arguments.out / ('analysis.json' if arguments.no_report else 'report.html')}")


def _settings(arguments: argparse.Namespace) -> Settings:
    study = None if arguments.study is None else read_study(arguments.study)
    questions = () if study is None else study.plan.questions
    registered = Rules() if study is None else study.plan.rules
    given = {"failed_checks": arguments.failed_checks, "missing_share": arguments.missing}
    rules = {name: value for name, value in given.items() if value is not None}
    straight = arguments.exclude_straight_lining or registered.straight_lining
    return Settings(
        scale=Scale() if arguments.scale is None else Scale(*arguments.scale),
        scales=() if arguments.scale is not None else tuple((question.name, question.scale) for question in questions),
        rules=structs.replace(registered, straight_lining=straight, **rules),
        confidence=arguments.confidence,
        alternative=arguments.alternative,
        seed=arguments.seed,
        margin=arguments.margin,
        titles=tuple((question.name, question.text.replace("{method}", "each method")) for question in questions),
        study=study,
    )


def _write(analysis: Analysis, folder: Path, arguments: argparse.Namespace) -> None:
    content = json.dumps(as_json(analysis), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "analysis.json").write_text(content + "\n", encoding="utf-8")
    (folder / "results.md").write_text(markdown(analysis), encoding="utf-8")
    (folder / "results.tex").write_text(latex(analysis), encoding="utf-8")
    if arguments.no_report:
        return
    pictures = (
        None if arguments.study is None else arguments.study if arguments.study.is_dir() else arguments.study.parent
    )
    (folder / "report.html").write_text(report.html(analysis, arguments.title, pictures), encoding="utf-8")
    (folder / "figures").mkdir()
    for name, figure in (
        ("likert", figures.likert(analysis)),
        ("means", figures.means(analysis)),
        ("positions", figures.positions(analysis)),
    ):
        for suffix in ("pdf", "svg"):
            figures.save(figure, folder / "figures" / f"{name}.{suffix}")


def _tell(question: str) -> None:
    print(f"testing {question} …", file=sys.stderr, flush=True)
