"""``anystyle study analyze``: from answers to tests, tables, figures and a report."""

import argparse
import json
import sys
from pathlib import Path

from msgspec import structs

from anystyle.commands._flags import new_parser
from anystyle.io.atomic import atomic_directory
from anystyle_study import figures, report, wording
from anystyle_study.analysis import Analysis, Settings, analyze, as_json
from anystyle_study.commands._options import build_tests
from anystyle_study.contract import Scale
from anystyle_study.protocol import Rules, read_study
from anystyle_study.reading import read_responses


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle study analyze``."""
    words = new_parser(
        "study analyze",
        "Read answers (CSV, JSON or SQLite, one a row), undo the positions, exclude participants by the design's rules "
        "and test every question. Writes analysis.json, results.md, results.tex, report.html and figures/.",
        epilog="Words such as wilcoxon.zero_method=pratt set a test's options; anystyle plugins study_test lists them.",
    )
    add = words.add_argument
    add("responses", nargs="+", help="files of answers, or folders of them; and TEST.OPTION=VALUE")
    add("--out", type=Path, required=True, help="folder for the results")
    add("--study", type=Path, help="the designed study, which the form's answers need")
    add("--scale", type=float, nargs=2, metavar=("LOW", "HIGH"), help="answer scale (default: 1 5)")
    add("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    add("--title", default="User study", help="title of the report")
    add("--confidence", type=float, default=0.95, help="level of all intervals (default: %(default)s)")
    alternative = "of all tests and intervals; less claims that ours is preferred (default: %(default)s)"
    add("--alternative", choices=("two-sided", "less", "greater"), default="two-sided", help=alternative)
    add("--seed", type=int, default=0, help="seed of all resampling (default: %(default)s)")
    way = "fraction of the way from neutral to the end of the scale within which a preference counts as none"
    add("--margin", type=float, metavar="FRACTION", help=f"test for equivalence: {way}")
    add("--failed-checks", type=int, metavar="N", help="attention checks one may fail (default: the design's)")
    add("--exclude-straight-lining", action="store_true", help="exclude participants who gave one answer throughout")
    missing = "fraction of missing answers above which a participant is excluded (default: the design's)"
    add("--missing", type=float, metavar="FRACTION", help=missing)
    add("--no-report", action="store_true", help="no figures and no page: needs no matplotlib")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it."""
    if not arguments.no_report:
        figures.require_matplotlib()
    study = None if arguments.study is None else read_study(arguments.study)
    questions = () if study is None else study.plan.questions
    rules = Rules() if study is None else study.plan.rules
    given = {"failed_checks": arguments.failed_checks, "missing_share": arguments.missing}
    given |= {"straight_lining": arguments.exclude_straight_lining or None}
    settings = Settings(
        scale=Scale() if arguments.scale is None else Scale(*arguments.scale),
        scales={} if arguments.scale is not None else {question.name: question.scale for question in questions},
        rules=structs.replace(rules, **{name: value for name, value in given.items() if value is not None}),
        titles={question.name: question.text.replace("{method}", "each method") for question in questions},
        study=study,
        **{name: getattr(arguments, name) for name in ("confidence", "alternative", "seed", "margin")},
    )
    files = [word for word in arguments.responses if Path(word).exists() or "=" not in word]
    overrides = [word for word in arguments.responses if word not in files]
    common = {name: getattr(settings, name) for name in ("confidence", "alternative", "seed")}
    tests = build_tests(arguments.test, overrides, common)
    records = read_responses([Path(word) for word in files], settings.study)
    analysis = analyze(records, tests, settings, lambda name: print(f"testing {name} …", file=sys.stderr, flush=True))
    with atomic_directory(arguments.out) as folder:
        _write(analysis, folder, arguments)
    print(wording.took_part(analysis))
    for question in analysis.questions:
        print(f"{question.question}: {wording.verdict(analysis, question)}")
    for item in analysis.checks.exclusions:
        print(f"excluded: {item.participant} ({item.rule})")
    print(f"{arguments.out / ('analysis.json' if arguments.no_report else 'report.html')}")


def _write(analysis: Analysis, folder: Path, arguments: argparse.Namespace) -> None:
    texts = {
        "analysis.json": json.dumps(as_json(analysis), indent=1, ensure_ascii=False) + "\n",
        "results.md": report.markdown(analysis),
        "results.tex": report.latex(analysis),
    }
    if not arguments.no_report:
        study: Path | None = arguments.study
        texts["report.html"] = report.html(
            analysis, arguments.title, study if study is None or study.is_dir() else study.parent
        )
        (folder / "figures").mkdir()
        for draw in (figures.likert, figures.means, figures.positions):
            figure = draw(analysis)
            for suffix in ("pdf", "svg"):
                figures.save(figure, folder / "figures" / f"{draw.__name__}.{suffix}")
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
