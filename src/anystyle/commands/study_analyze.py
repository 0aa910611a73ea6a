"""``anystyle study analyze``: from answers to tests, tables, figures and a report."""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from anystyle.commands._study_options import build_tests
from anystyle.io.atomic import atomic_directory
from anystyle.study import figures, report
from anystyle.study.analysis import Analysis, Settings, analyze
from anystyle.study.analysis_json import as_json
from anystyle.study.checks import Rules
from anystyle.study.contract import Scale
from anystyle.study.form import comparison
from anystyle.study.protocol import Study, read_study
from anystyle.study.reading import Records, read_responses
from anystyle.study.tabulate import latex, markdown
from anystyle.study.verdicts import verdict


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle study analyze``."""
    words = argparse.ArgumentParser(
        prog="anystyle study analyze",
        description="Read answers (CSV, JSON or SQLite; long, with the columns participant, item, question, score, "
        "ours_is, or wide), undo the positions, check them, and test every question at the level of responses, "
        "participants and items. Writes analysis.json, table.md, table.tex, report.html and figures/.",
        epilog="Words such as wilcoxon.zero_method=pratt set a test's options; anystyle plugins study_test lists them.",
        allow_abbrev=False,
    )
    words.add_argument("responses", nargs="+", help="files of answers, or folders of them; and TEST.OPTION=VALUE")
    words.add_argument("--out", type=Path, required=True, help="where the results go")
    words.add_argument("--study", type=Path, help="the designed study: texts of the questions, scale, methods' names")
    words.add_argument("--scale", type=float, nargs=2, metavar=("LOW", "HIGH"), help="the answer scale (default: 1 5)")
    words.add_argument("--test", action="append", default=[], metavar="NAME", help="run only these tests")
    words.add_argument("--title", default="User study", help="of the report")
    words.add_argument("--confidence", type=float, default=0.95, help="of the intervals (default: %(default)s)")
    words.add_argument("--resamples", type=int, default=1999, help="for intervals of effects (default: %(default)s)")
    words.add_argument("--seed", type=int, default=0, help="of all resampling (default: %(default)s)")
    words.add_argument(
        "--failed-checks", type=int, default=0, metavar="N", help="attention checks a participant may fail (default: 0)"
    )
    words.add_argument(
        "--exclude-straight-lining", action="store_true", help="leave out who gave one answer throughout"
    )
    words.add_argument("--missing", type=float, default=0.5, metavar="SHARE", help="of answers missing that excludes")
    words.add_argument("--no-report", action="store_true", help="no figures and no page: needs no matplotlib")
    return words


def command(arguments: argparse.Namespace) -> None:
    """Run it.

    Raises:
        ValueError: The answers or the options make no analysis.
    """
    if not arguments.no_report:
        figures.require()
    if not 0.5 <= arguments.confidence < 1:
        raise ValueError(f"--confidence {arguments.confidence:g}: expected a share from 0.5 to below 1, such as 0.95")
    if arguments.resamples < 99:
        raise ValueError(f"--resamples {arguments.resamples}: expected at least 99")
    files = [word for word in arguments.responses if Path(word).exists() or "=" not in word]
    overrides = [word for word in arguments.responses if word not in files]
    tests = build_tests(arguments.test, overrides)
    study = None if arguments.study is None else read_study(arguments.study)
    records = read_responses([Path(word) for word in files])
    settings = Settings(
        scale=_scale(arguments, study),
        rules=Rules(
            failed_checks=arguments.failed_checks,
            straight_lining=arguments.exclude_straight_lining,
            missing_share=arguments.missing,
        ),
        confidence=arguments.confidence,
        resamples=arguments.resamples,
        seed=arguments.seed,
        titles=() if study is None else tuple((one.name, one.text) for one in study.plan.questions),
    )
    analysis = analyze(_named(records, study), tests, settings, progress=_tell)
    with atomic_directory(arguments.out) as folder:
        _write(analysis, folder, arguments)
    for question in analysis.questions:
        print(f"{question.question}: {verdict(question)}")
    excluded = analysis.checks.exclusions
    if excluded:
        print(f"left out: {', '.join(f'{item.participant} ({item.rule})' for item in excluded)}")
    print(f"{arguments.out / ('analysis.json' if arguments.no_report else 'report.html')}")


def _scale(arguments: argparse.Namespace, study: Study | None) -> Scale:
    if arguments.scale is not None:
        return Scale(*arguments.scale)
    return Scale() if study is None else study.plan.scale


def _named(records: Records, study: Study | None) -> Records:
    """The records with the baselines called by their names, where the study is known."""
    if study is None:
        return records
    names = records.comparison.astype(object)
    for baseline in study.baselines:
        names[records.comparison == comparison(study, baseline)] = baseline
    return replace(records, comparison=np.array(names.tolist()))


def _write(analysis: Analysis, folder: Path, arguments: argparse.Namespace) -> None:
    content = json.dumps(as_json(analysis), indent=1, ensure_ascii=False, allow_nan=False)
    (folder / "analysis.json").write_text(content + "\n", encoding="utf-8")
    (folder / "table.md").write_text(markdown(analysis), encoding="utf-8")
    (folder / "table.tex").write_text(latex(analysis), encoding="utf-8")
    if arguments.no_report:
        return
    (folder / "report.html").write_text(report.html(analysis, arguments.title), encoding="utf-8")
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
