"""Reading and checking answers, and everything that can be wrong with a file."""

import json
import sqlite3
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest
from study_cases import answer_rows, write_csv

from anystyle_study.checks import Rules, check
from anystyle_study.contract import Scale
from anystyle_study.reading import read_responses


def judged(path, rules=None, scale=None):
    return check(read_responses([path]), scale=scale or Scale(), rules=rules or Rules())


def table_of(responses):
    """Deviations by participant and item."""
    names = zip(
        (responses.participant_names[p] for p in responses.participants),
        (responses.item_names[i] for i in responses.items),
        strict=True,
    )
    return dict(zip(names, responses.deviations.tolist(), strict=True))


def expected_table(rows, question="style"):
    return {(p, i): (s - 3) * (1 if side == "A" else -1) for p, i, q, s, side in rows if q == question}


@pytest.fixture
def rows():
    return answer_rows(questions=("style", "content"))


def test_positions_are_undone(tmp_path, rows):
    checks, (style, content) = judged(write_csv(tmp_path / "r.csv", rows))
    assert table_of(style) == expected_table(rows)
    assert table_of(content) == expected_table(rows, "content")
    assert checks.answers_used == len(rows)
    assert not checks.findings


def test_every_format_says_the_same(tmp_path, rows):
    names = ("participant", "item", "question", "score", "ours_is")
    write_csv(tmp_path / "long.csv", rows)
    (tmp_path / "semicolons.csv").write_text(
        "\ufeff"
        + ";".join(name.upper() for name in names)
        + "\r\n"
        + "\r\n".join(";".join(map(str, row)) for row in rows)
    )
    objects = [dict(zip(names, row, strict=True)) for row in rows]
    (tmp_path / "list.json").write_text(json.dumps(objects))
    (tmp_path / "object.json").write_text(json.dumps({"study": "x", "responses": objects}))
    with closing(sqlite3.connect(tmp_path / "table.sqlite")) as database, database:
        database.execute("CREATE TABLE notes (text)")
        database.execute("CREATE TABLE answers (participant, item, question, score INTEGER, ours_is)")
        database.executemany("INSERT INTO answers VALUES (?, ?, ?, ?, ?)", rows)
    (tmp_path / "tabs.tsv").write_text("\n".join("\t".join(map(str, row)) for row in (names, *rows)))
    write_csv(tmp_path / "more.csv", [(*row, "well") for row in rows], ",".join((*names, "remark")))
    (tmp_path / "people").mkdir()
    for person in {row[0] for row in rows}:
        answers = [dict(zip(names[1:], row[1:], strict=True)) for row in rows if row[0] == person]
        (tmp_path / "people" / f"{person}.json").write_text(json.dumps({"participant": person, "responses": answers}))
    files = sorted(tmp_path.iterdir())
    assert len(files) == 8
    for file in files:
        _, by_question = judged(file)
        tables = {responses.question: table_of(responses) for responses in by_question}
        assert tables == {name: expected_table(rows, name) for name in ("style", "content")}, file.name
    assert read_responses([tmp_path / "more.csv"]).unused == ("remark",)


def test_findings_and_exclusions_are_listed(tmp_path):
    rows = [(*row, "", "") for row in answer_rows(people=10, items=10)]
    straight = [("STRAIGHT", f"S{item:02d}", "style", 4, "AB"[item % 2], "", "") for item in range(10)]
    lazy = [("LAZY", "S00", "style", 2, "A", "", "")]
    rows += [
        *straight,
        *lazy,
        ("P03", "S01", "style", 5, "A", "", "=SUM(A1)"),
        ("P04", "S02", "style", "", "A", "", ""),
        ("P08", "S10", "style", "", "A", "", ""),
    ]
    rows[0] = (*rows[0][:3], 9, *rows[0][4:])
    rows += [(person, "check-1", "style", 5 if person != "P07" else 1, "", 5, "") for person in ("P06", "P07")]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,expected,comment")
    records = read_responses([path])
    records = replace(records, assigned={answer.participant: 10 for answer in records.answers})
    checks, (style,) = check(records, scale=Scale(), rules=Rules())
    assert {(finding.kind, finding.participant) for finding in checks.findings} == {
        ("straight_lining", "STRAIGHT"),
        ("missing", "LAZY"),
        ("missing", "P00"),
        ("duplicated", "P03"),
        ("out_of_range", "P00"),
        ("failed_attention_check", "P07"),
        ("duplicated", "P04"),
    }
    assert {exclusion.participant for exclusion in checks.exclusions} == {"LAZY", "P07"}
    assert checks.attention_answers == 2
    assert records.comments == (("P03", "=SUM(A1)"),)
    present = {style.participant_names[index] for index in style.participants}
    assert "STRAIGHT" in present
    assert not present & {"LAZY", "P07"}
    assert checks.answers_used == style.count == 10 * 9 + 10 - 1
    stricter, _ = check(records, scale=Scale(), rules=Rules(straight_lining=True, failed_checks=1))
    assert {exclusion.participant for exclusion in stricter.exclusions} == {"LAZY", "STRAIGHT"}
    unplanned, _ = judged(path)
    assert [finding.participant for finding in unplanned.findings if finding.kind == "missing"] == ["P08"]
    assert {exclusion.participant for exclusion in unplanned.exclusions} == {"P07"}
    assert any("stopped early" in note for note in unplanned.notes)


def test_the_first_of_two_answers_counts(tmp_path):
    rows = answer_rows(people=3, items=2)
    again = [("P01", "S01", "style", 5 if rows[3][3] != 5 else 1, "A")]
    checks, (style,) = judged(write_csv(tmp_path / "r.csv", rows + again))
    assert table_of(style) == expected_table(rows)
    assert len(checks.of_kind("duplicated")) == 1


def test_several_comparisons_are_kept_apart(tmp_path):
    rows = [(*row, "rival" if row[1] < "S03" else "other") for row in answer_rows()]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,comparison")
    _, by_question = judged(path)
    assert [responses.question for responses in by_question] == ["style vs rival", "style vs other"]
    assert [responses.count for responses in by_question] == [36, 36]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"participant,item,question,score,ours_is\n", "no answers"),
        (b"a,b,c\n1,2,3\n", "lacks the columns participant, item, question, score; it has a, b, c"),
        (
            b"participant,item,question,score\nP1,S1,q,3\n",
            "does not say where ours was: give the design with --study, or add ours_is",
        ),
        (b"participant,item,question,score,ours_is\nP1,S1,q,good,A\n", "row 2: score is 'good'"),
        (b"participant,item,question,score,ours_is\nP1,S1,q,3,left\n", "row 2: ours_is is 'left'"),
        (
            b"participant,item,question,score,method\nP1,S1,q,3,styl3r\n",
            "row 2: method is 'styl3r'; expected ours or theirs",
        ),
        (b"participant,item,question,score,ours_is\nP1,S1,q,3,A,5\n", "row 2 has 6 cells"),
        (b"participant,item,question,score,ours_is\n,S1,q,3,A\n", "row 2: participant is empty"),
        (b"participant,item,question,score,score\nP1,S1,q,3,3\n", "'score' twice"),
        (b"participant,item,question,score,ours_is\nP\xe9,S1,q,3,A\n", "not UTF-8"),
        (b"participant,item\0,question", "binary"),
        (b'{"responses": 3}', "list of answers"),
        (b"{nothing", "no list of answers"),
        (b"SQLite format 3\0 and then nothing of the kind" * 30, "no readable SQLite file"),
        (b"participant,S1:style,S1:ours_is\nP1,3,A\n", "expected one answer a row, in participant, item, question"),
    ],
)
def test_bad_files_end_in_one_line(tmp_path, content, words):
    path = tmp_path / ("r.json" if content[:1] in b"[{" and content else "r.csv")
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"^[^\n]+$") as error:
        judged(path)
    assert words in str(error.value)


def test_a_database_without_answers_is_named(tmp_path):
    with closing(sqlite3.connect(tmp_path / "r.sqlite")) as database, database:
        database.execute("CREATE TABLE notes (text)")
    with pytest.raises(ValueError, match=r"no table with the columns .* \['notes'\]"):
        judged(tmp_path / "r.sqlite")


def test_mixed_scales_are_refused(tmp_path):
    rows = answer_rows()
    mixed = [(*row[:3], row[3] * 20, row[4]) if row[0] < "P03" else row for row in rows]
    with pytest.raises(ValueError, match=r"'style' has answers from 1 to 80 where the scale is 1 to 5"):
        judged(write_csv(tmp_path / "r.csv", mixed))
    wide = [(*row[:3], row[3] * 20, row[4]) for row in rows]
    _, (style,) = judged(write_csv(tmp_path / "s.csv", wide), scale=Scale(0.0, 120.0))
    assert np.abs(style.deviations).max() <= 60


def test_nothing_left_is_said(tmp_path):
    path = write_csv(
        tmp_path / "r.csv",
        [("P1", "S1", "style", 3, "A", ""), ("P1", "check", "style", 1, "", 5)],
        "participant,item,question,score,ours_is,expected",
    )
    with pytest.raises(ValueError, match=r"no answers are left of 2: 1 participant\(s\) with more than 0 attention"):
        judged(path)


def test_answers_on_one_side_only_are_noted(tmp_path):
    rows = [(*row[:4], "A") for row in answer_rows()]
    checks, _ = judged(write_csv(tmp_path / "r.csv", rows))
    assert "always shown as A" in checks.notes[0]
