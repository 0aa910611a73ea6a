"""The analysis as a whole: its files, its words, its speed, and that no text gets out of hand."""

import json
import math
import re

import numpy as np
import pytest
from scipy import stats

from anystyle.errors import UserError
from anystyle_paper import published_scores
from anystyle_study.analysis import AnalysisOptions, analyze, as_json
from anystyle_study.checks import check
from anystyle_study.command import StudyCommand
from anystyle_study.contract import Scale
from anystyle_study.protocol import Rules
from anystyle_study.reading import read_responses
from anystyle_study.report import html as report_html
from anystyle_study.report import latex, markdown
from anystyle_study.significance import CrossedT, OneSampleT, SignFlip, Wilcoxon
from anystyle_study.wording import p_text, registered, response_level, took_part, verdict
from tests.support.study_cases import answer_rows, small_study, write_csv

PLAIN = {"one_sample_t": OneSampleT(), "wilcoxon": Wilcoxon()}
TESTS = PLAIN | {"sign_flip": SignFlip(resamples=499), "crossed_t": CrossedT()}


def run(*arguments):
    """Run ``anystyle study analyze``."""
    StudyCommand()(["analyze", *map(str, arguments)])


@pytest.fixture(scope="module")
def analysis(tmp_path_factory):
    rows = answer_rows(people=12, items=6, questions=("style", "content", "overall"))
    return analyze(read_responses([write_csv(tmp_path_factory.mktemp("answers") / "r.csv", rows)]), TESTS)


def test_every_test_is_run_at_every_unit(analysis):
    for question in as_json(analysis)["questions"].values():
        run = [(row["name"], row["unit"]) for row in question["tests"]]
        three = [(name, unit) for name in ("one_sample_t", "wilcoxon") for unit in ("response", "participant", "item")]
        assert run == [*three, *((name, "participant") for name in ("sign_flip", "crossed_t"))]
        for row in question["tests"]:
            assert {"statistic", "pvalue", "alternative", "estimate", "interval", "effect", "n"} <= set(row)
            assert row["interval"] == [None, None] or row["interval"][0] <= row["estimate"] <= row["interval"][1]


def test_the_published_tests_come_from_the_plain_scores(tmp_path):
    rows = answer_rows(people=20, items=10)
    plain = PLAIN | {"wilcoxon": Wilcoxon(method="approx")}
    found = as_json(analyze(read_responses([write_csv(tmp_path / "r.csv", rows)]), plain))
    scores = np.array([score if side == "A" else 6 - score for _, _, _, score, side in rows]).reshape(20, 10)
    tests = {(row["name"], row["unit"]): row for row in found["questions"]["style"]["tests"]}
    for unit, values in (("response", scores.ravel()), ("participant", scores.mean(1)), ("item", scores.mean(0))):
        t = stats.ttest_1samp(values, 3)
        w = stats.wilcoxon(values - 3, method="approx", correction=False)
        assert tests["one_sample_t", unit]["pvalue"] == pytest.approx(t.pvalue, rel=1e-10)
        assert tests["one_sample_t", unit]["statistic"] == pytest.approx(t.statistic, rel=1e-10)
        assert tests["wilcoxon", unit]["pvalue"] == pytest.approx(w.pvalue, rel=1e-10)
    assert found["questions"]["style"]["mean"] == pytest.approx(scores.mean())
    assert found["questions"]["style"]["distribution"] == {str(k): int((scores == k).sum()) for k in range(1, 6)}


def test_the_papers_p_values_take_every_answer_for_a_person(tmp_path):
    """Counts that give both printed values; by participant the same answers say far less."""
    printed = json.loads(published_scores.BUNDLED.read_text())["user_study"]
    scores = np.repeat(np.arange(1, 6), printed["counts"])
    rows = [(f"P{index // 20}", f"S{index % 20}", "style", score, "A") for index, score in enumerate(scores)]
    less: dict = {"one_sample_t": OneSampleT(alternative="less"), "wilcoxon": Wilcoxon(alternative="less")}
    found = analyze(read_responses([write_csv(tmp_path / "r.csv", rows)]), less, AnalysisOptions(alternative="less"))
    tests = {(row["name"], row["unit"]): row for row in as_json(found)["questions"]["style"]["tests"]}
    for row in printed["tests"]:
        assert f"{tests[row['test'], row['unit']]['pvalue']:.2e}" == row["pvalue"]
    t = tests["one_sample_t", "response"]["statistic"]
    assert (round(t, 2), f"{stats.t.cdf(-13.98, 799):.2e}") == (-13.98, "3.43e-40")
    assert tests["one_sample_t", "participant"]["pvalue"] == pytest.approx(0.0018, abs=5e-5)


def test_holm_is_over_the_questions(analysis):
    rows = [question["tests"][1] for question in as_json(analysis)["questions"].values()]
    least = min(rows, key=lambda row: row["pvalue"])
    assert least["pvalue_holm"] == pytest.approx(min(1, 3 * least["pvalue"]), rel=1e-9)
    assert all(row["pvalue_holm"] >= row["pvalue"] * (1 - 1e-9) for row in rows)


def test_the_report_says_what_response_level_tests_do(analysis):
    page = report_html(analysis)
    assert "counts every answer as an independent one" in response_level(analysis) in page
    assert f"{100 * analysis.questions[0].variation.naive_error_rate:.0f} %" in page


def test_nothing_reassures_about_participants_who_are_too_few(tmp_path):
    few = analyze(read_responses([write_csv(tmp_path / "r.csv", answer_rows(people=4, items=10))]), PLAIN)
    assert "too few to show how much people differ" in response_level(few)


SCENES = "participant,item,question,score,ours_is,scene,style"


def judged(tmp_path, deviations, settings):
    """An analysis of a table of deviations, participants by items, ours always A."""
    rows = [
        (f"P{person:02d}", f"S{item:02d}", "style", 3 + deviation, "A", f"c{item % 5}", f"t{item // 5}")
        for person, row in enumerate(deviations)
        for item, deviation in enumerate(row)
    ]
    records = read_responses([write_csv(tmp_path / "r.csv", rows, SCENES)])
    return analyze(records, {"crossed_t": CrossedT(confidence=settings.confidence)}, settings)


def test_a_verdict_follows_the_p_value(tmp_path):
    """Four people of one mind have p = 0.125, and no interval."""
    judged(tmp_path, np.full((4, 3), -1), AnalysisOptions())
    found = analyze(read_responses([tmp_path / "r.csv"]), {"sign_flip": SignFlip()}, AnalysisOptions())
    told = verdict(found, found.questions[0])
    assert told.startswith("No preference is shown for new participants, these sets (p = 0.125")


@pytest.mark.parametrize(
    ("shift", "spread", "words"),
    [
        (-0.9, 0.5, "Ours is preferred, and"),
        (0.9, 0.5, "Theirs is preferred, and"),
        (-0.12, 0.4, "Ours is preferred, by less than the margin of 0.5 points"),
        (0.0, 0.5, "Comparable for new participants, scenes and styles"),
        (0.0, 1.9, "No preference is shown"),
    ],
)
def test_a_verdict_is_a_preference_or_comparable_and_never_both(tmp_path, shift, spread, words):
    random = np.random.default_rng(1)
    latent = shift + random.normal(0, 0.6, (30, 20)) + (random.normal(0, 0.5, (30, 1)) if spread > 1 else 0)
    latent += random.normal(0, 0.8, (1, 20)) if spread > 1 else 0
    latent -= latent.mean() - shift
    found = judged(tmp_path, np.clip(np.rint(latent), -2, 2).astype(int), AnalysisOptions(margin=0.25))
    (question,) = found.questions
    text = verdict(found, question)
    assert text.startswith(words)
    assert ("preferred" in text) + ("Comparable" in text) + ("No preference" in text) == 1
    low, high = question.primary.result.interval
    assert question.equivalence.shown == (low > -0.5 and high < 0.5)
    assert (question.equivalence.pvalue < 0.025) == question.equivalence.shown


@pytest.mark.slow
def test_confidence_and_alternative_reach_every_figure(tmp_path):
    path = write_csv(tmp_path / "r.csv", answer_rows(people=20, items=10))
    results = {}
    for words in (("--confidence", 0.9), ("--confidence", 0.99), ("--alternative", "less"), ("--seed", 5)):
        run(path, "--out", tmp_path / f"out{words[-1]}", "--no-report", *words)
        content = json.loads((tmp_path / f"out{words[-1]}" / "analysis.json").read_text())
        results[words[-1]] = content["questions"]["style"]

    def intervals(question):
        listed = [*question["tests"], *question["effects"], *question["items"], question["position"]]
        return np.array([one["interval"] for one in listed], dtype=float)

    narrow, wide = (np.diff(intervals(results[share])).ravel() for share in (0.9, 0.99))
    given = np.isfinite(narrow) & np.isfinite(wide)
    assert given.sum() >= 15
    assert (narrow[given] < wide[given]).all()
    assert all(test["interval"][0] is None for test in results["less"]["tests"])
    assert {test["alternative"] for test in results["less"]["tests"]} == {"less"}
    flips = [next(t for t in results[key]["tests"] if t["name"] == "sign_flip")["interval"] for key in (0.9, 5)]
    assert flips[0] != flips[1]


def test_no_verdict_where_most_are_excluded_or_one_is_left(tmp_path):
    rows = [(*row, "") for row in answer_rows(people=10, items=8, shift=-1.5)]
    rows += [(f"P{person:02d}", "check", "style", 1 if person < 6 else 5, "", 5) for person in range(10)]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,expected")
    found = analyze(read_responses([path]), PLAIN)
    assert verdict(found, found.questions[0]) == "No conclusion is possible: 6 of 10 participants were excluded."
    assert "6 were left out (6 for more than 0 attention checks failed)" in took_part(found)
    one = answer_rows(people=1, items=8, shift=-1.5)
    found = analyze(read_responses([write_csv(tmp_path / "s.csv", one)]), PLAIN)
    assert "No conclusion is possible: one participant" in verdict(found, found.questions[0])


def test_checks_that_are_skipped_or_failed_by_ratings_are_found(tmp_path):
    designed, _ = small_study(tmp_path)
    (skipped, rated, halved, stopped), (degraded,) = designed.participants, designed.checks
    rows = []
    for one in designed.participants:
        for name in one.order if one != stopped else one.order[: one.order.index(degraded.id)]:
            if (one, name) != (skipped, degraded.id):
                intact_is_a, liked = name in one.ours_is_a, (one, name) != (rated, degraded.id)
                a, b = (4, 2) if intact_is_a == liked else (2, 4)
                scores = (("style", "", 2 if intact_is_a else 4), ("content", "A", a), ("content", "B", b))
                rows += [(one.id, name, *score) for score in scores]
    rows.append((stopped.id, degraded.id, "content", "A", 2))  # in the middle of the check
    for absent in ({"style"}, {"A"}, {"B"}):  # of one person's check
        kept = [row for row in rows if row[:2] != (halved.id, degraded.id) or not absent & {*row[2:4]}]
        path = write_csv(tmp_path / "a.csv", kept, "participant,item,question,side,score")
        found, _ = check(read_responses([path], designed), scale=Scale(), rules=Rules())
        failed = [finding.participant for finding in found.findings if finding.kind == "failed_attention_check"]
        assert sorted(failed) == [skipped.id, rated.id, halved.id]
    ours_is_a = {(one.id, name) for one in designed.participants for name in one.ours_is_a}
    kept = [(*row[:3], row[4], "A" if row[:2] in ours_is_a else "B") for row in rows if row[2] == "style"]
    write_csv(path, kept, "participant,item,question,score,ours_is")  # which says what the design does, too
    found = check(read_responses([path], designed), scale=Scale(), rules=Rules())[0]
    assert found.attention_answers == len([row for row in kept if row[1] == degraded.id]) > 0
    assert skipped.id in {one.participant for one in found.findings if one.kind == "failed_attention_check"}
    write_csv(path, [(*kept[0][:4], "B" if kept[0][4] == "A" else "A")], "participant,item,question,score,ours_is")
    with pytest.raises(ValueError, match=r"row 2: ours_is is [AB], and by the design it was [AB]"):
        check(read_responses([path], designed), scale=Scale(), rules=Rules())
    write_csv(path, [(*kept[0][:4], "left")], "participant,item,question,score,ours_is")
    with pytest.raises(ValueError, match="row 2: ours_is is 'left'; expected A or B"):
        check(read_responses([path], designed), scale=Scale(), rules=Rules())
    write_csv(path, [row for row in rows if row[1] != degraded.id], "participant,item,question,side,score")
    assert not check(read_responses([path], designed), scale=Scale(), rules=Rules())[0].exclusions  # it has no checks


def test_a_designed_study_is_undone_and_reported(tmp_path, capsys):
    """Answers as the form keeps them: the design says where ours was, what is a check, and who was to answer what."""
    designed, _ = small_study(tmp_path, participants=12, repeats=1)
    rows = []
    for number, participant in enumerate(designed.participants):
        for name in participant.order[: 1 if number == 5 else None]:
            prefers = name in participant.ours_is_a  # everybody likes ours, and what is intact
            rows.append((designed.id, participant.id, name, "style", "", 2 if prefers else 4, 9))
            for side in "AB":
                score = 3 if (side == "A") == prefers else 2
                rows.append((designed.id, participant.id, name, "content", side, score, 9))
    path = write_csv(tmp_path / "a.csv", rows, "study,participant,item,question,side,score,seconds")
    run(path, "--study", tmp_path / "study", "--out", tmp_path / "out", "study_test=[crossed_t,wilcoxon]")
    assert "style: " in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "analysis.json").read_text())
    assert content["questions"]["style"]["mean"] == 2
    assert content["questions"]["content"]["ratings"] == {"ours": 3.0, "theirs": 2.0}
    assert [one["participant"] for one in content["checks"]["missing"]] == ["P06"]
    assert [one["participant"] for one in content["checks"]["excluded"]] == ["P06"]
    assert content["checks"]["failed_attention_check"] == []
    page, paper = ((tmp_path / "out" / name).read_text() for name in ("report.html", "results.md"))
    assert page.index("Registered plan") < page.index("Results") < page.index("Best for ours")
    assert page.count('<img alt="ours"') == page.count('<img alt="other"') > 0
    assert all(f"{item.scene}</td><td>{item.style}" in page for item in designed.items)
    assert designed.id in paper and "nan" not in paper.replace("anan", "")
    with pytest.raises(UserError, match="does not say where ours was"):
        run(path, "--out", tmp_path / "other")


def test_the_text_names_what_is_missing(tmp_path):
    designed, _ = small_study(tmp_path)
    left, right, *_ = designed.participants
    rows = [
        (one.id, name, question, side, "NA" if one is left and question == "style" else 3)
        for one in (left, right)
        for name in one.order
        for question, side in (("style", ""), ("content", "A"), ("content", "B"))
        if one is left or (question, side) != ("content", "B")
    ]
    last = max(index for index, row in enumerate(rows) if row[1] in {item.id for item in designed.items})
    rows[last] = (*rows[last][:-1], 7)
    path = write_csv(tmp_path / "a.csv", rows, "participant,item,question,side,score")
    records = read_responses([path], designed)
    scales = {"style": Scale(), "content": Scale(1, 5)}
    settings = AnalysisOptions(scales=scales, rules=Rules(missing_share=1.0, failed_checks=None), study=designed)
    found = analyze(records, {"one_sample_t": TESTS["one_sample_t"]}, settings)
    assert any("No rule excludes participants." in text for text in registered(found))
    assert took_part(found).endswith(
        "9 answers are missing (style 4, content 5), of P01: style 4; P02: content 5. Those outside of the scale count "
        "as missing: 1, of P02. Nobody answered as P03, P04."
    )
    assert took_part(found) in markdown(found)
    with pytest.raises(ValueError, match=r"a\.csv, row 2: no question is named 'styel'"):
        write_csv(path, [(*rows[0][:2], "styel", "", 3)], "participant,item,question,side,score")
        read_responses([path], designed)


def test_no_text_gets_out_of_hand(tmp_path):
    evil = "<script>alert(1)</script>"
    rows = [(*row, "") for row in answer_rows(people=4, items=4)]
    rows = [(row[0].replace("P01", f"{evil}&"), row[1].replace("S01", "$x_1$ | `a`"), *row[2:]) for row in rows]
    rows = [(*row[:2], f"style {evil}", *row[3:]) for row in rows]
    rows[0] = (*rows[0][:5], "=HYPERLINK(1) <img src=x onerror=alert(1)>")
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,comment")
    found = analyze(read_responses([path]), {"one_sample_t": OneSampleT()}, AnalysisOptions())
    page = report_html(found, title=evil)
    assert not re.search(r"<(script|img|iframe|object|link)|(src|href)=\"[^#]", page)
    assert "&lt;img src=x onerror=alert(1)&gt;" in page
    assert "<script" not in markdown(found) + latex(found)


@pytest.mark.parametrize(("people", "items", "score"), [(1, 6, 2), (6, 1, 2), (1, 1, 3), (6, 6, 3), (6, 6, 2)])
def test_answers_that_say_little_give_a_report_all_the_same(tmp_path, people, items, score):
    rows = [(*row[:3], score if row[4] == "A" else 6 - score, row[4]) for row in answer_rows(people, items)]
    found = analyze(read_responses([write_csv(tmp_path / "r.csv", rows)]), TESTS)
    content = json.loads(json.dumps(as_json(found), allow_nan=False))
    for row in content["questions"]["style"]["tests"]:
        assert row["pvalue"] is not None or row["note"]
    assert content["questions"]["style"]["mean"] == score and len(report_html(found)) > 10_000
    for text in (markdown(found), latex(found), "".join(verdict(found, one) for one in found.questions)):
        assert "nan" not in text
    if people == 1:
        assert any("One participant" in note for note in found.checks.notes)


def test_p_values_as_people_write_them():
    texts = ["= 0.050", "= 1.000", "= 0.0004", "= 3.47e-40", "n/a"]
    assert [p_text(p) for p in (0.0499, 0.99999, 0.00042, 3.47e-40, math.nan)] == texts


@pytest.mark.slow
def test_the_command_writes_everything_twice_the_same(tmp_path):
    path = write_csv(tmp_path / "r.csv", answer_rows(people=10, items=6, questions=("style", "content")))
    for name in ("one", "two"):
        run(path, "study_test.sign_flip.resamples=199", "--out", tmp_path / name)
    names = sorted(path.relative_to(tmp_path / "one").as_posix() for path in (tmp_path / "one").rglob("*.*"))
    assert names == [
        ".anystyle",  # what was written here, so that nothing else is ever replaced
        "analysis.json",
        *(f"figures/{name}.{suffix}" for name in ("likert", "means") for suffix in ("pdf", "svg")),
        "report.html",
        "results.md",
        "results.tex",
    ]
    for name in names:
        assert (tmp_path / "one" / name).read_bytes() == (tmp_path / "two" / name).read_bytes(), name
    tests = json.loads((tmp_path / "one" / "analysis.json").read_text())["questions"]["style"]["tests"]
    assert any("199 sign patterns" in row["method"] for row in tests)


def test_hydra_composes_the_tests(tmp_path, capsys):
    path = write_csv(tmp_path / "r.csv", [(*row[:3], "ABCDE"[row[3] - 1], row[4]) for row in answer_rows()])
    words = ["study_test=[sign_flip,wilcoxon]", "study_test.sign_flip.resamples=99", "--confidence", 0.9]
    run(path, *words, "--cfg", "job")
    shown = capsys.readouterr().out
    assert "resamples: 99" in shown and "CrossedT" not in shown
    run(path, "--labels", *"ABCDE", *words, "--out", tmp_path / "out", "--no-report")
    tests = json.loads((tmp_path / "out" / "analysis.json").read_text())["questions"]["style"]["tests"]
    assert {row["name"] for row in tests} == {"sign_flip", "wilcoxon"}
    assert {row["confidence"] for row in tests} == {0.9} and "99 sign patterns" in tests[0]["method"]


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("nowhere.csv", "--out", "out"), "no table of answers nowhere.csv"),
        (("r.csv", "--out", "out", "--scale", "5", "1"), "scale 5 to 1"),
        (("r.csv", "--out", "out", "study_test=[wilcoxn]"), "Did you mean 'wilcoxon'"),
        (("r.csv", "nothing=1", "--out", "out"), "'nothing' is unknown"),
        (("r.csv", "+nothing=1", "--out", "out"), "'nothing' is unknown"),
        (("r.csv", "study_test.wilcoxon.alternative=less", "--out", "out"), "'alternative' not in 'Wilcoxon'"),
        (("--out", "out"), "no file of responses is given"),
        (("r.csv", "study_test.wilcoxon.method=exakt", "--out", "out"), "of [auto, approx]\n"),
        (("r.csv", "--out", "out", "--confidence", "95"), "0.95"),
        (("r.csv", "--out", "out", "--failed-checks", "-1"), "failed_checks"),
        (("r.csv", "--out", "out", "--margin", "5"), "--margin 5"),
        (("r.csv", "--out", "out", "--margin", "0.1", "--alternative", "less"), "two-sided"),
    ],
)
def test_errors_leave_nothing(tmp_path, words, told, monkeypatch):
    write_csv(tmp_path / "r.csv", answer_rows(people=4, items=4))
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError) as error:
        run(*words)
    assert told in f"{error.value}\n" and not (tmp_path / "out").exists()
