"""The analysis as a whole: its files, its words, its speed, and that no text gets out of hand."""

import html.parser
import json
import math
import subprocess
import sys

import numpy as np
import pytest
from anystyle.study.tests.cluster_bootstrap import ClusterBootstrap
from anystyle.study.tests.equivalence import Equivalence
from anystyle.study.variance import variation
from scipy import stats
from study_cases import answer_rows, write_csv

from anystyle.commands._run import FAILED
from anystyle.study.analysis import Settings, analyze
from anystyle.study.analysis_json import as_json
from anystyle.study.contract import Responses
from anystyle.study.reading import read_responses
from anystyle.study.report import html as report_html
from anystyle.study.tabulate import escape_tex, markdown, p_text
from anystyle.study.tests.one_sample_t import OneSampleT
from anystyle.study.tests.ordinal_mixed import OrdinalMixed
from anystyle.study.tests.sign_flip import SignFlip
from anystyle.study.tests.wilcoxon import Wilcoxon
from anystyle.study.verdicts import response_level

TESTS = {
    "one_sample_t": OneSampleT(),
    "wilcoxon": Wilcoxon(),
    "sign_flip": SignFlip(resamples=499),
    "cluster_bootstrap": ClusterBootstrap(resamples=999),
    "ordinal_mixed": OrdinalMixed(),
    "equivalence": Equivalence(),
}
QUESTIONS = ("style", "content", "overall")


def study(*arguments, cwd, check=None):
    """Run ``anystyle study`` as a person does."""
    command = [sys.executable, "-m", "anystyle", "study", *map(str, arguments)]
    done = subprocess.run(command, cwd=cwd, capture_output=True, text=True)
    if check is not None:
        assert done.returncode == check, done.stderr
    return done


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    rows = answer_rows(people=20, items=10, questions=QUESTIONS)
    path = write_csv(tmp_path_factory.mktemp("answers") / "r.csv", rows)
    return analyze(read_responses([path]), TESTS, Settings(resamples=299))


def test_every_test_is_run_at_every_unit(analysis):
    for question in as_json(analysis)["questions"].values():
        assert [(row["name"], row["unit"]) for row in question["tests"]] == [
            ("one_sample_t", "response"),
            ("one_sample_t", "participant"),
            ("one_sample_t", "item"),
            ("wilcoxon", "response"),
            ("wilcoxon", "participant"),
            ("wilcoxon", "item"),
            ("sign_flip", "participant"),
            ("cluster_bootstrap", "participant"),
            ("ordinal_mixed", "participant"),
            ("equivalence", "participant"),
            ("equivalence", "item"),
        ]
        for row in question["tests"]:
            assert {"statistic", "pvalue", "alternative", "estimate", "interval", "effect", "n"} <= set(row)
            assert row["interval"][0] <= row["estimate"] <= row["interval"][1]


def test_the_published_tests_come_from_the_plain_scores(tmp_path):
    rows = answer_rows(people=20, items=10)
    found = as_json(analyze(read_responses([write_csv(tmp_path / "r.csv", rows)]), TESTS, Settings(resamples=99)))
    scores = np.array([score if side == "A" else 6 - score for _, _, _, score, side in rows]).reshape(20, 10)
    tests = {(row["name"], row["unit"]): row for row in found["questions"]["style"]["tests"]}
    for unit, values in (("response", scores.ravel()), ("participant", scores.mean(1)), ("item", scores.mean(0))):
        t = stats.ttest_1samp(values, 3, alternative="less")
        w = stats.wilcoxon(values - 3, alternative="less", method="approx", correction=False)
        assert tests["one_sample_t", unit]["pvalue"] == pytest.approx(t.pvalue, rel=1e-10)
        assert tests["one_sample_t", unit]["statistic"] == pytest.approx(t.statistic, rel=1e-10)
        assert tests["wilcoxon", unit]["pvalue"] == pytest.approx(w.pvalue, rel=1e-10)
    assert found["questions"]["style"]["mean"] == pytest.approx(scores.mean())
    assert found["questions"]["style"]["distribution"] == {str(k): int((scores == k).sum()) for k in range(1, 6)}


def test_holm_is_over_the_questions(analysis):
    rows = [question["tests"][1] for question in as_json(analysis)["questions"].values()]
    ordered = sorted(rows, key=lambda row: row["pvalue"])
    assert ordered[0]["pvalue_holm"] == pytest.approx(min(1, 3 * ordered[0]["pvalue"]), rel=1e-9)
    assert all(row["pvalue_holm"] >= row["pvalue"] * (1 - 1e-9) for row in rows)


def test_the_report_says_that_the_response_level_test_fails(analysis):
    page = report_html(analysis)
    assert "The response-level test fails here" in page
    assert "instead of 5 %" in response_level(analysis)
    rate = analysis.questions[0].variation.naive_error_rate
    assert f"{100 * rate:.0f} %" in page


def test_variance_components_of_a_balanced_table():
    random = np.random.default_rng(0)
    values = random.normal(0, 0.6, (300, 1)) + random.normal(0, 0.3, (1, 200)) + random.normal(0, 1, (300, 200))
    person, item = np.divmod(np.arange(values.size), 200)
    found = variation(
        Responses(
            question="q",
            deviations=values.ravel(),
            participants=person,
            items=item,
            participant_names=tuple(map(str, range(300))),
            item_names=tuple(map(str, range(200))),
        )
    )
    assert (found.participant_sd, found.item_sd, found.residual_sd) == pytest.approx((0.6, 0.3, 1.0), abs=0.05)
    expected = (0.36 / 300 + 0.09 / 200 + 1 / 60000) / (1.45 / 60000)
    assert found.design_effect == pytest.approx(expected, rel=0.15)


class Texts(html.parser.HTMLParser):
    """The tags of a page, and what it loads."""

    def __init__(self) -> None:
        super().__init__()
        self.tags, self.links = set(), []

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.links += [
            value
            for name, value in attrs
            if name in ("src", "href", "xlink:href") and value and not value.startswith("#")
        ]


def test_no_text_gets_out_of_hand(tmp_path):
    evil = "<script>alert(1)</script>"
    rows = [(*row, "") for row in answer_rows(people=4, items=4)]
    rows = [(row[0].replace("P01", f"{evil}&"), row[1].replace("S01", "$x_1$ | `a`"), *row[2:]) for row in rows]
    rows = [(*row[:2], f"style {evil}", *row[3:]) for row in rows]
    rows[0] = (*rows[0][:5], "=HYPERLINK(1) <img src=x onerror=alert(1)>")
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,comment")
    found = analyze(read_responses([path]), {"one_sample_t": OneSampleT()}, Settings(resamples=99))
    page = report_html(found, title=evil)
    parser = Texts()
    parser.feed(page)
    assert "<script" not in page
    assert "<img" not in page
    assert not parser.tags & {"script", "img", "iframe", "object", "link"}
    assert parser.links == []
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
    assert "<script" not in markdown(found)
    assert r"\$x\_1\$" in escape_tex("$x_1$")


@pytest.mark.parametrize("score", [3, 2])
@pytest.mark.parametrize(("people", "items"), [(1, 6), (6, 1), (1, 1), (6, 6)])
def test_answers_that_say_little_give_a_report_all_the_same(tmp_path, people, items, score):
    rows = [(*row[:3], score if row[4] == "A" else 6 - score, row[4]) for row in answer_rows(people, items)]
    found = analyze(read_responses([write_csv(tmp_path / "r.csv", rows)]), TESTS, Settings(resamples=99))
    content = json.loads(json.dumps(as_json(found), allow_nan=False))
    for row in content["questions"]["style"]["tests"]:
        assert (row["pvalue"] is None) == bool(row["note"])
    assert content["questions"]["style"]["mean"] == score
    assert len(report_html(found)) > 10_000
    if people == 1:
        assert any("One participant" in note for note in found.checks.notes)


def test_p_values_as_people_write_them():
    assert [p_text(p) for p in (0.0499, 0.99999, 0.00042, 3.47e-40, math.nan)] == [
        "= 0.050",
        "= 1.000",
        "= 0.0004",
        "= 3.47e-40",
        "n/a",
    ]
    assert p_text(5e-324, -591.2) == "= 1e-591"


def test_the_command_writes_everything_twice_the_same(tmp_path):
    write_csv(tmp_path / "r.csv", answer_rows(people=10, items=6, questions=("style", "content")))
    words = ("analyze", "r.csv", "cluster_bootstrap.resamples=199", "--resamples", 99)
    done = study(*words, "--out", "one", cwd=tmp_path, check=0)
    assert "style: " in done.stdout
    study(*words, "--out", "two", cwd=tmp_path, check=0)
    names = sorted(path.relative_to(tmp_path / "one").as_posix() for path in (tmp_path / "one").rglob("*.*"))
    assert names == [
        "analysis.json",
        *(f"figures/{name}.{suffix}" for name in ("likert", "means", "positions") for suffix in ("pdf", "svg")),
        "report.html",
        "table.md",
        "table.tex",
    ]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    tests = json.loads((tmp_path / "one" / "analysis.json").read_text())["questions"]["style"]["tests"]
    assert any("199 resamples" in row["method"] for row in tests)


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ((), "required"),
        (("nowhere.csv", "--out", "out"), "no table of answers nowhere.csv"),
        (("r.csv", "--out", "out", "--scale", "5", "1"), "scale 5 to 1"),
        (("r.csv", "--out", "out", "--test", "t_tset"), "t_tset"),
        (("r.csv", "wilcoxon.zero=1", "--out", "out", "--no-report"), "zero_method"),
        (("r.csv", "nothing=1", "--out", "out"), "TEST.OPTION=VALUE"),
        (("r.csv", "--out", "out", "--confidence", "95"), "0.95"),
        (("empty.csv", "--out", "out"), "is empty"),
        (("latin.csv", "--out", "out"), "not UTF-8"),
    ],
)
def test_errors_are_one_line_and_leave_nothing(tmp_path, words, told, monkeypatch, capsys):
    from anystyle.commands import study as command
    from anystyle.commands._run import run

    write_csv(tmp_path / "r.csv", answer_rows(people=4, items=4))
    (tmp_path / "empty.csv").write_text("")
    (tmp_path / "latin.csv").write_bytes("participant,item,question,score,ours_is\né,S,q,3,A\n".encode("latin-1"))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as left:
        run(lambda: command.main(["analyze", *words]))
    assert left.value.code == FAILED
    error = capsys.readouterr().err
    assert error.startswith("anystyle: error: ")
    assert error.count("\n") == 1
    assert told in error
    assert not (tmp_path / "out").exists()


def test_a_hundred_thousand_answers_fit_into_little_memory(tmp_path):
    write_csv(tmp_path / "r.csv", answer_rows(people=1000, items=50, questions=("style", "content")))
    # A process of its own counts one child: this one's children include those of every test before.
    count = (
        "import resource, subprocess, sys; subprocess.run(sys.argv[1:], check=True);"
        "print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)"
    )
    command = [sys.executable, "-m", "anystyle", "study", "analyze", "r.csv", "--out", "out", "--no-report"]
    counted = subprocess.run(
        [sys.executable, "-c", count, *command], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    peak = int(counted.stdout.split()[-1])
    assert peak < 1_000_000, f"{peak / 1e6:.2f} GB"
