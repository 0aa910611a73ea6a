"""Who answered: sessions, spellings, forms that were sent twice, and the columns that name people."""

import csv
import itertools

import pytest

from anystyle.errors import UserError
from anystyle_study.analysis import AnalysisOptions, analyze
from anystyle_study.checks import check
from anystyle_study.contract import Scale
from anystyle_study.protocol import Rules
from anystyle_study.reading import read_responses
from anystyle_study.significance import CrossedT
from anystyle_study.wording import verdict
from tests.support.study_cases import HEADER, small_study, write_csv


def judged(paths, rules=None, **reading):
    return check(read_responses(paths, **reading), scale=Scale(), rules=rules or Rules())


def session(prefers_ours, people=range(1, 7)):
    """Six people who agree, ours as A in every second set."""
    rows = []
    for person, item in itertools.product(people, range(1, 7)):
        a = item % 2 == 1
        score = 3 if (person + item) % 4 == 0 else 1 if a == prefers_ours else 5
        rows.append((person, f"S{item}", "style", score, "AB"[not a]))
    return rows


@pytest.fixture
def sessions(tmp_path):
    """Two sessions whose people are numbered from 1: the first prefers ours, the second theirs."""
    return [write_csv(tmp_path / f"session{number}.csv", session(number == 1)) for number in (1, 2)]


def test_people_who_are_numbered_anew_in_each_file_are_not_one(sessions):
    with pytest.raises(UserError) as refused:
        read_responses(sessions)
    told = str(refused.value)
    assert "1, 2, 3 and 3 others" in told and "27 of the 36" in told and "session1.csv and session2.csv" in told
    assert "--sessions" in told and "\n" not in told
    records = read_responses(sessions, sessions=True)
    people = {answer.participant for answer in records.answers}
    assert people == {f"{n}-session{s}" for n in range(1, 7) for s in (1, 2)}
    found = analyze(records, {"crossed_t": CrossedT()}, AnalysisOptions())
    assert found.checks.answers_used == 72 and found.questions[0].responses.deviations.mean() == 0
    assert "No preference" in verdict(found, found.questions[0])


def test_equal_scores_for_the_other_side_are_other_answers(tmp_path):
    first = write_csv(tmp_path / "a.csv", session(True))
    second = write_csv(tmp_path / "b.csv", [(*row[:4], "BA"[row[4] == "B"]) for row in session(True)])
    with pytest.raises(UserError, match="answered 36 of the 36 questions"):
        read_responses([first, second])


def test_a_column_says_the_session_as_well(tmp_path):
    rows = [(*row, number) for number in (1, 2) for row in session(number == 1)]
    path = write_csv(tmp_path / "all.csv", rows, f"{HEADER},Session")
    with pytest.raises(UserError, match=r"27 of the 36 .* session 1 of all.csv and session 2 of all.csv .* --sessions"):
        read_responses([path])
    people = {answer.participant for answer in read_responses([path], sessions=True).answers}
    assert people == {f"{n}-{s}" for n in range(1, 7) for s in (1, 2)}
    both = write_csv(tmp_path / "more.csv", [(*row, 1) for row in session(False)], f"{HEADER},session")
    assert len({a.participant for a in read_responses([path, both], sessions=True).answers}) == 18


def test_two_sessions_of_other_sets_are_told_to_be_of_the_same_people(tmp_path, caplog):
    first = write_csv(tmp_path / "a.csv", session(True))
    second = write_csv(tmp_path / "b.csv", [(row[0], row[1] + "x", *row[2:]) for row in session(False)])
    assert len({answer.participant for answer in read_responses([first, second]).answers}) == 6
    assert "1, 2, 3 and 3 others are in a.csv and b.csv, and count as the same people" in caplog.text
    assert "--sessions" in caplog.text


def test_the_same_file_twice_counts_once_and_is_told(tmp_path):
    for name in ("a.csv", "b.csv"):
        write_csv(tmp_path / name, session(True))
    (tmp_path / "._a.csv").write_bytes(b"\0\5\26\7")  # as a Mac leaves on a stick, and Excel beside an open file
    (tmp_path / "~$a.csv").write_bytes(b"\0")
    checks, (style,) = judged([tmp_path])
    assert (checks.answers_read, style.count) == (72, 36)
    (note,) = [note for note in checks.notes if "more than once" in note]
    assert note.startswith("36 answers were given more than once (1: 6, 2: 6, 3: 6 and 3 others; in a.csv and b.csv)")
    assert note.endswith("The first counts; all are alike.")


def test_a_person_who_answers_twice_is_told_with_numbers_and_a_blank_is_no_answer(tmp_path):
    rows = session(True)
    again = [(*row[:3], 2, row[4]) for row in rows if row[0] == 3]
    rows = [(*row[:3], "" if (row[0], row[1]) == (3, "S2") else row[3], row[4]) for row in rows]
    checks, (style,) = judged([write_csv(tmp_path / "r.csv", [*rows, *again])])
    given = {style.item_names[i]: d for i, p, d in zip(style.items, style.participants, style.deviations, strict=True)
             if style.participant_names[p] == "3"}  # fmt: skip
    assert given["S2"] == 1 and len(given) == 6  # the later answer, 2 where ours was B, in place of the blank
    differ = sum(row[3] != 2 for row in rows if row[0] == 3 and row[3] != "")
    (note,) = [note for note in checks.notes if "more than once" in note]
    assert note == f"5 answers were given more than once (3: 5). The first counts; {differ} differ."


@pytest.mark.parametrize(
    "names",
    [
        *(("P01", "p01 ", "P01\u00a0"), ("5F3A", "5f3a", "5f3a "), ("P1", "P01", "P001"), ("7", "7.0", "07")),
        *(("P 01", "P-01", "P_01"), ("P1", "P.1", "P1."), ("Zoe\u0301", "Zo\u00e9", "ZO\u00c9")),
        *(("anna lee", "Anna  Lee", "anna\u00a0lee"), ("an\u200bna", "anna", "anna")),
    ],
)
def test_spellings_of_one_person_are_refused_with_both_names(tmp_path, names):
    rows = session(True)
    rows = [(names[place % 3] if row[0] == 1 else f"Q{row[0]}", *row[1:]) for place, row in enumerate(rows)]
    with pytest.raises(UserError, match="differ in case, blanks, dashes, dots or zeros alone") as refused:
        read_responses([write_csv(tmp_path / "r.csv", rows)])
    assert repr(names[0].strip()) in str(refused.value)


def test_spellings_of_one_set_or_question_are_refused(tmp_path):
    for column, what in ((1, "sets are named 'S2' and 's 2'"), (2, "questions are named 'Style' and 'style'")):
        rows = [list(row) for row in session(True)]
        rows[1][column] = {1: "s 2", 2: "Style"}[column]
        with pytest.raises(UserError, match=what):
            read_responses([write_csv(tmp_path / "r.csv", rows)])


def test_two_sessions_in_one_table_without_a_column_for_them_are_refused(tmp_path):
    path = write_csv(tmp_path / "all.csv", [*session(True), *session(False)])
    with pytest.raises(UserError, match=r"1, 2, 3 and 3 others gave two different answers .* session and add --sessio"):
        read_responses([path])


def test_names_that_are_only_alike_are_not_spellings(tmp_path):
    names = ["P01", "P10", "P01-2", "P012"] * 9
    rows = [(name, f"{row[1]} of {row[0]}", *row[2:]) for name, row in zip(names, session(True), strict=True)]
    assert len({answer.participant for answer in read_responses([write_csv(tmp_path / "r.csv", rows)]).answers}) == 4


TEXTS = ("Start Date", "Response Type", "What is your Prolific ID?", "Which is closer to the style?", "ours_is")
IDS = tuple(f'{{"ImportId":"{name}"}}' for name in ("startDate", "status", "PID", "QID1", "x"))


@pytest.mark.parametrize("header", [(TEXTS, IDS), ()])
@pytest.mark.parametrize(
    ("real", "preview"), [("IP Address", "Survey Preview"), ("0", "1"), ("IP Address", "Spam"), ("0", "8")]
)
def test_the_export_of_qualtrics_is_read(tmp_path, caplog, header, real, preview):
    names = ("StartDate", "Status", "PROLIFIC_PID", "S1_style", "S1_ours_is")
    people = [("2026-03-01", real, f"5f{number:022d}", 1 + number % 3, "A") for number in range(8)]
    tried = [("2026-02-27", preview, "test", 1, "A")]
    with (tmp_path / "q.csv").open("w", newline="", encoding="utf-8-sig") as file:
        csv.writer(file).writerows([names, (), *header, (), *people, *tried])  # blank rows
    records = read_responses([tmp_path / "q.csv"], wide=True)
    left_out = 0 if real == "0" and not header else 1  # without Qualtrics' rows, 1 may be any code
    assert len({answer.participant for answer in records.answers}) == 9 - left_out
    assert records.answers[0].participant == "5f" + 22 * "0" and ("rows 2 to 3" in caplog.text) == bool(header)
    assert ("1 previews of the survey are left out" in caplog.text) == bool(left_out)
    assert "q.csv: people are named by the column PROLIFIC_PID" in caplog.text


@pytest.mark.parametrize("column", ["subject", "workerId", "participant.code", "Participant ID", "ResponseId"])
def test_the_column_that_names_people_is_found(tmp_path, caplog, column):
    path = write_csv(tmp_path / "r.csv", session(True), HEADER.replace("participant", column))
    assert {answer.participant for answer in read_responses([path]).answers} == set("123456")
    assert f"people are named by the column {column}" in caplog.text
    path = write_csv(tmp_path / "s.csv", [(*row, "x") for row in session(True)], f"{HEADER},{column}")
    caplog.clear()
    assert {answer.participant for answer in read_responses([path]).answers} == set("123456") and not caplog.records


def test_rows_without_a_name_are_people_of_their_file(tmp_path):
    for name, score in (("a", 1), ("b", 5)):
        (tmp_path / f"{name}.csv").write_text(f"S1:style,S1:ours_is\n{score},A\n{score},A\n")
    records = read_responses(sorted(tmp_path.glob("*.csv")), wide=True)
    assert len({answer.participant for answer in records.answers}) == 4


def lined(style, content):
    """One person's answers to ten comparisons and as many pairs of ratings; nine others vary."""
    rows = []
    for person, item in itertools.product(range(10), range(10)):
        given = (style, content) if person == 0 else (1 + (person + item) % 5, 1 + (2 * person + item) % 5)
        about = (f"P{person}", f"S{item}")
        rows.append((*about, "style", given[0] or 1 + item % 5, "AB"[item % 2], ""))
        rows += [(*about, "content", given[1] or 1 + item % 5, "", method) for method in ("ours", "theirs")]
    return rows


@pytest.mark.parametrize(
    ("style", "content", "listed", "excluded"),
    [(5, 4, 2, True), (5, 5, 2, True), (3, 0, 1, False), (0, 5, 1, False), (0, 0, 0, False)],
)
def test_straight_lining_is_found_in_each_question(tmp_path, style, content, listed, excluded):
    path = write_csv(tmp_path / "r.csv", lined(style, content), f"{HEADER},method")
    checks, _ = judged([path], Rules(straight_lining=True))
    assert [finding.participant for finding in checks.of_kind("straight_lining")] == listed * ["P0"]
    assert [one.participant for one in checks.exclusions] == excluded * ["P0"]


@pytest.mark.parametrize("code", [99, -9, 0])
def test_a_code_for_what_is_missing_is_told_how_to_be_given(tmp_path, code):
    rows = [(*row[:3], code if place % 9 == 0 else row[3], row[4]) for place, row in enumerate(session(True))]
    path = write_csv(tmp_path / "r.csv", rows)
    with pytest.raises(UserError, match=rf"the scale is 1 to 5; .* --label={code}=NA"):
        judged([path])
    assert judged([path], labels={str(code): float("nan")})[0].answers_used == 32


def test_sessions_of_a_design_keep_its_codes(tmp_path):
    study, _ = small_study(tmp_path)
    for name, score in (("one", 2), ("two", 4)):
        person = study.participants[0]
        rows = [(person.id, item, "style", score) for item in person.order]
        write_csv(tmp_path / f"{name}.csv", rows, "participant,item,question,score")
    paths = [tmp_path / "one.csv", tmp_path / "two.csv"]
    with pytest.raises(UserError, match="P01 answered"):
        read_responses(paths, study)
    records = read_responses(paths, study, sessions=True)
    assert {answer.participant for answer in records.answers} == {"P01-one", "P01-two"}
    assert records.assigned == {"P01-one": 4, "P01-two": 4}
