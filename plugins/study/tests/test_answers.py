"""Reading and checking answers, and everything that can be wrong with a file."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from anystyle_study.cells import AnswerColumn, given_scale, given_words, scale_words
from anystyle_study.checks import Rules, check
from anystyle_study.contract import Scale
from anystyle_study.reading import read_responses
from tests.support.study_cases import answer_rows, write_csv


def judged(path, rules=None, scale=None, **reading):
    return check(read_responses([path], **reading), scale=scale or Scale(), rules=rules or Rules())


def table_of(responses):
    """Deviations by participant and item."""
    people, items = np.array(responses.participant_names), np.array(responses.item_names)
    keys = zip(people[responses.participants].tolist(), items[responses.items].tolist(), strict=True)
    return dict(zip(keys, responses.deviations.tolist(), strict=True))


def expected_table(rows, question="style"):
    return {(p, i): (s - 3) * (1 if side == "A" else -1) for p, i, q, s, side in rows if q == question}


def agree(found, rows):
    """Whether what was read has the deviations of these rows, by question."""
    return {one.question: table_of(one) for one in found} == {q: expected_table(rows, q) for _, _, q, *_ in rows}


@pytest.fixture
def rows():
    return answer_rows(questions=("style", "content"))


def test_positions_are_undone(tmp_path, rows):
    checks, found = judged(write_csv(tmp_path / "r.csv", rows))
    assert agree(found, rows) and checks.answers_used == len(rows)
    assert not checks.findings


def test_every_format_says_the_same(tmp_path, rows, caplog):
    names = ("participant", "item", "question", "score", "ours_is")
    write_csv(tmp_path / "long.csv", rows)
    lines = [";".join(map(str, row)) for row in ([name.upper() for name in names], *rows)]
    (tmp_path / "semicolons.csv").write_text("\ufeff" + "\r\n".join(lines))
    objects = [dict(zip(names, row, strict=True)) for row in rows]
    (tmp_path / "list.json").write_text(json.dumps(objects))
    (tmp_path / "object.json").write_text(json.dumps({"study": "x", "responses": objects}))
    (tmp_path / "tabs.tsv").write_text("\n".join("\t".join(map(str, row)) for row in (names, *rows)))
    write_csv(tmp_path / "more.csv", [(*row, "well") for row in rows], ",".join((*names, "remark")))
    (tmp_path / "people").mkdir()
    for person in {row[0] for row in rows}:
        answers = [dict(zip(names[1:], row[1:], strict=True)) for row in rows if row[0] == person]
        (tmp_path / "people" / f"{person}.json").write_text(json.dumps({"participant": person, "responses": answers}))
    files = sorted(tmp_path.iterdir())
    assert len(files) == 7
    (tmp_path / "people" / "gone.json").write_text(json.dumps({"participant": "gone", "responses": []}))
    for file in files:
        assert agree(judged(file)[1], rows), file.name
    assert "left out without answers: gone.json" in caplog.text
    assert read_responses([tmp_path / "more.csv"]).unused == ("remark",)


JSPSYCH = """\
"view_history","rt","trial_type","trial_index","plugin_version","time_elapsed","participant","item","question",\
"ours_is","stimulus","response","score","slider_start","question_order"
"[{""page_index"":0,""viewing_time"":313}]","313","instructions","0","2.1.0","322","P01","","","","","","","",""
"","389","html-button-response","1","2.1.0","713","P01","S1","style","A","<p>Which, ""A"" or B?</p>","0","1","",""
"","67","html-slider-response","2","2.1.0","782","P01","S1","strength","A","How much?","2","2","3",""
"","197","survey-likert","3","2.2.0","981","P01","S1","content","A","","{""content"":1}","2","","[0]"
"","49","html-button-response","4","2.1.0","1031","P01","S2","style","B","<p>Which, ""A"" or B?</p>","2","3","",""
"","69","html-slider-response","5","2.1.0","1101","P01","S2","strength","B","How much?","3","3","3",""
"","290","survey-likert","6","2.2.0","1392","P01","S2","content","B","","{""content"":2}","3","","[0]"
"""
"""As jsPsych 8.3 writes the data of its trials with the properties that docs/user_study.md adds."""
OTREE = """\
participant,item,question,score,ours_is
rv9xh9uy,S1,style,1,A
rv9xh9uy,S1,content,2,A
rv9xh9uy,S2,style,3,B
rv9xh9uy,S2,content,3,B
rmqh5cxm,S1,style,,B
"""
"""As oTree 6.0 writes what the function ``custom_export`` of docs/user_study.md yields."""


@pytest.mark.parametrize(("name", "text", "person"), [("jspsych", JSPSYCH, "P01"), ("otree", OTREE, "rv9xh9uy")])
def test_answers_of_jspsych_and_otree_are_read(tmp_path, caplog, name, text, person):
    (tmp_path / f"{name}.csv").write_text(text)
    records = read_responses([tmp_path / f"{name}.csv"])
    found = {(a.participant, a.item, a.question): (a.score, a.ours_is_a) for a in records.answers if a.score > 0}
    expected = {("S1", "style"): (1, True), ("S1", "content"): (2, True), ("S2", "style"): (3, False)}
    expected |= {("S2", "content"): (3, False)}
    expected |= {("S1", "strength"): (2, True), ("S2", "strength"): (3, False)} if name == "jspsych" else {}
    assert found == {(person, *key): value for key, value in expected.items()}
    assert ("1 rows without item and score are left out" in caplog.text) == (name == "jspsych")


def test_findings_and_exclusions_are_listed(tmp_path):
    rows = [(*row, "", "") for row in answer_rows(people=10, items=10)]
    straight = [("STRAIGHT", f"S{item:02d}", "style", 4, "AB"[item % 2], "", "") for item in range(10)]
    rows += [*straight, ("LAZY", "S00", "style", 2, "A", "", ""), ("P03", "S01", "style", 5, "A", "", "=SUM(A1)")]
    rows += [(person, item, "style", "", "A", "", "") for person, item in (("P04", "S02"), ("P08", "S10"))]
    rows[0] = (*rows[0][:3], 9, *rows[0][4:])
    rows += [(person, "check-1", "style", 5 if person != "P07" else 1, "", 5, "") for person in ("P06", "P07")]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,expected,comment")
    records = read_responses([path])
    records = replace(records, assigned={answer.participant: 10 for answer in records.answers})
    checks, (style,) = check(records, scale=Scale(), rules=Rules())
    assert {(finding.kind, finding.participant) for finding in checks.findings} == {
        *((kind, "P00") for kind in ("missing", "out_of_range")),
        ("duplicated", "P03"),  # but not P04, whose second row is empty
        *(("straight_lining", "STRAIGHT"), ("missing", "LAZY"), ("failed_attention_check", "P07")),
    }
    assert {exclusion.participant for exclusion in checks.exclusions} == {"LAZY", "P07"}
    assert checks.attention_answers == 2
    assert records.comments == (("P03", "=SUM(A1)"),)
    present = {style.participant_names[index] for index in style.participants}
    assert "STRAIGHT" in present and not present & {"LAZY", "P07"}
    assert checks.answers_used == style.count == 10 * 9 + 10 - 1
    first = next(row for row in rows if row[:2] == ("P03", "S01"))
    assert table_of(style)["P03", "S01"] == (first[3] - 3) * (1 if first[4] == "A" else -1)
    stricter, _ = check(records, scale=Scale(), rules=Rules(straight_lining=True, failed_checks=1))
    assert {exclusion.participant for exclusion in stricter.exclusions} == {"LAZY", "STRAIGHT"}
    unplanned, _ = judged(path)
    assert [finding.participant for finding in unplanned.findings if finding.kind == "missing"] == ["P00", "P08"]
    assert {exclusion.participant for exclusion in unplanned.exclusions} == {"P07"}
    assert any("stopped early" in note for note in unplanned.notes)


def test_several_comparisons_are_kept_apart(tmp_path):
    rows = [(*row, "rival" if row[1] < "S03" else "other") for row in answer_rows()]
    header = "participant,item,question,score,ours_is,comparison"
    _, by_question = judged(write_csv(tmp_path / "r.csv", rows, header))
    assert [responses.question for responses in by_question] == ["style vs rival", "style vs other"]
    assert [responses.count for responses in by_question] == [36, 36]
    # Of all sets with each of them, one person's answers about one are missing.
    lost = [(*row[:3], "" if row[0] == "P00" else row[3], row[4], "other") for row in answer_rows()]
    both = write_csv(tmp_path / "both.csv", [*((*row, "rival") for row in answer_rows()), *lost], header)
    checks, _ = judged(both, Rules(missing_share=0.4))
    assert checks.missing == {"P00": {"style": 6}} and [one.participant for one in checks.exclusions] == ["P00"]


HEAD = b"participant,item,question,score,ours_is\n"
METHODS = b"participant,item,question,score,method\n"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "there are no answers in r.csv"),
        (HEAD, "no answers"),
        (b"a,b,c\n1,2,3\n", "lacks the columns participant, item, question, score; it has a, b, c"),
        (HEAD[:-9] + b"\nP1,S1,q,3\n", "does not say where ours was: give the design with --study, or add ours_is"),
        (HEAD + b"P1,S1,q,good,A\n", "row 2: score is 'good'"),
        (HEAD + b"P1,S1,q,3,left\n", "row 2: ours_is is 'left'"),
        (METHODS + b"P1,S1,q,3,styl3r\n", "row 2: method is 'styl3r'; expected ours or theirs"),
        (HEAD + b"P1,S1,q,3,A,5\n", "row 2 has 6 cells"),
        (HEAD + b",S1,q,3,A\n", "row 2: participant is empty"),
        (HEAD[:-1] + b",scene\nP1,S1,q,3,A,a\nP2,S1,q,3,A,b\n", "sets of several scenes or styles: S1; give each"),
        (HEAD[:-1] + b",method\nP1,S1,q,3,A,\nP1,S2,q,3,,ours\n", "question 'q' has both comparisons and ratings"),
        (b"participant,item,question,score,score\nP1,S1,q,3,3\n", "'score' twice"),
        (HEAD + b"P\x81,S1,q,3,A\n", "not UTF-8"),
        ((HEAD.decode() + "P1,S1,q,3").encode("utf-16")[:-1], "not UTF-16"),
        (b"PK\3\4 a workbook", "is a workbook or an archive; save its sheet of answers as CSV UTF-8"),
        (HEAD + b'P1,S1,q,"1,234",A\n', "score is '1,234'"),
        (HEAD + b"P1,S1,q,3 - 4,A\n", "score is '3 - 4'"),
        (b"participant,item\0,question", "binary"),
        (b'{"responses": 3}', "list of answers"),
        (b"{nothing", "not a valid list of answers"),
        (b"SQLite format 3\0 and then nothing of the kind" * 30, "holds binary data; expected CSV or JSON"),
        (b"participant,S1:style,S1:ours_is\nP1,3,A\n", "expected one answer per row, in participant, item, question"),
    ],
)
def test_bad_files_end_in_one_line(tmp_path, content, words):
    path = tmp_path / ("r.json" if content[:1] in b"[{" and content else "r.csv")
    path.write_bytes(content)
    with pytest.raises(ValueError, match=r"^[^\n]+$") as error:
        judged(path)
    assert words in str(error.value)


def test_differences_of_scores_in_tenths_are_equal_where_they_are(tmp_path):
    path = write_csv(tmp_path / "r.csv", [("P1", "S1", "q", 0.8, "A"), ("P2", "S1", "q", 0.2, "B")])
    _, (responses,) = judged(path, scale=Scale(0, 1))
    assert [*responses.deviations] == [0.3, 0.3]


AB = ("A is much better", "A is better", "No difference", "B is better", "B is much better")


def rewritten(rows, score, separator=","):
    """A CSV of answers in which each score is written by a function."""
    written = [(*row[:3], score(row[3]), row[4]) for row in rows]
    head = ("participant", "item", "question", "score", "ours_is")
    return "".join(separator.join(map(str, row)) + "\n" for row in (head, *written))


@pytest.mark.parametrize(
    ("write", "told"),
    [
        (lambda rows: rewritten(rows, str).encode("utf-16"), ""),
        (lambda rows: rewritten(rows, str, "\t").encode("utf-16-le"), ""),
        (lambda rows: rewritten(rows, str).encode("utf-16-be"), ""),
        (lambda rows: rewritten(rows, str).encode("utf-32"), ""),
        (lambda rows: ("sep=;\r\n" + rewritten(rows, "{},0".format, ";")).encode(), ""),
        (lambda rows: rewritten(rows, "{},00".format, ";").replace("ours_is", "Ours is").encode(), ""),
        (lambda rows: rewritten(rows, '"{},0"'.format).encode(), ""),
        (lambda rows: rewritten(rows, str).replace("\n", ",,\n").encode(), ""),
        (lambda rows: rewritten(rows, "{} - rather so".format).encode(), "such as '"),
        (lambda rows: rewritten(rows, "rather so ({})".format).encode(), "such as 'rather so ("),
        (lambda rows: rewritten(rows, str).replace("P00", "Zo\xe9").encode("cp1252"), "Windows-1252, such as 'Zo\xe9'"),
        (lambda rows: rewritten(rows, lambda score: AB[score - 1].upper() + " ").encode(), ""),
        (lambda rows: rewritten(rows, lambda score: f"{score}: {AB[score - 1]}").encode(), "such as '"),
    ],
)
def test_answers_are_read_as_spreadsheets_write_them(tmp_path, rows, caplog, write, told):
    (tmp_path / "r.csv").write_bytes(write(rows))
    _, by_question = judged(tmp_path / "r.csv", labels=scale_words(AB, 1))
    assert agree(by_question, [(p.replace("P00", "Zo\xe9") if "Zo" in told else p, *row) for p, *row in rows])
    assert told in caplog.text and bool(told) == bool(caplog.records)


@pytest.mark.parametrize(
    ("cells", "semicolons", "numbers"),
    [
        (["3.5", "1e1", ".5", "-2", "−2"], False, [3.5, 10, 0.5, -2, -2]),
        (["3,5", "4", "1.234"], False, [3.5, 4, 1234]),
        (["1,234.5", "1,234"], False, [1234.5, 1234]),
        (["1.234", "2.500"], True, [1.234, 2.5]),
        (["1,234", "2"], True, [1.234, 2]),
        (["1,234", "0,5", "1 234,5", "1'000"], False, [1.234, 0.5, 1234.5, 1000]),
        (["1,234", "1,2,3", "1.5,3", "inf", "1_000", "3/4"], False, [None] * 6),
        (["NA", "n/a", "NaN", "–", "", "None", "<NA>"], False, [math.nan] * 7),
    ],
)
def test_numbers_of_a_column(cells, semicolons, numbers):
    column = AnswerColumn(cells, semicolons=semicolons)
    assert [column.number(cell) for cell in cells] == pytest.approx(numbers, nan_ok=True) or numbers == [None] * 6
    assert [column.number(cell) is None for cell in cells] == [number is None for number in numbers]


def test_words_without_a_score_are_listed_with_what_to_type(tmp_path, rows):
    (tmp_path / "r.csv").write_text(rewritten(rows, lambda score: AB[score - 1] if score != 3 else "Unsure"))
    with pytest.raises(ValueError, match=r"row \d+: score is .*'Unsure' \(\d+\).*--label WORD=SCORE --label WORD=NA$"):
        judged(tmp_path / "r.csv")
    words = given_words([[label.lower() for label in AB]], ["Unsure=NA", "A is better=2"], [Scale()])
    checks, (style, _) = judged(tmp_path / "r.csv", Rules(missing_share=1), labels=words)
    unsure = sum(row[3] == 3 for row in rows)
    assert checks.answers_used == checks.answers_read == len(rows) - unsure
    assert sum(count for counts in checks.missing.values() for count in counts.values()) == unsure
    assert table_of(style) == {key: value for key, value in expected_table(rows).items() if value}
    for labels, pairs in (([AB[:4]], []), ([AB], ["No difference=2"]), ([[*AB[:4], AB[0]]], []), ([], ["Unsure"])):
        with pytest.raises(ValueError, match="--label"):
            given_words(labels, pairs, [Scale()])
    assert AnswerColumn().score("5: no difference", words) is None and given_scale([AB * 2]) == Scale(1, 10)
    assert given_scale([]) == Scale()


def wide_of(rows, heading):
    """One row per person: a column for each item and question, and for each item where ours was."""
    people, items, questions = (list(dict.fromkeys(row[index] for row in rows)) for index in range(3))
    cells = {row[:3]: row[3:] for row in rows}
    columns = [(item, question) for item in items for question in questions]
    table = [["Timestamp", "Participant", *(heading(*column) for column in columns)]]
    table += [["2026/11/25 1:00", one, *(str(cells[one, *column][0]) for column in columns)] for one in people]
    return table, columns, cells


@pytest.mark.parametrize("heading", ["{}:{}", "{} [{}]", "{}_{}", "{} / {}"])
def test_one_row_a_person(tmp_path, rows, heading):
    table, columns, cells = wide_of(rows, heading.format)
    for item in dict.fromkeys(item for item, _ in columns):
        table[0].append(heading.format(item, "ours_is"))
        for line in table[1:]:
            line.append(cells[line[1], item, "style"][1])
    write_csv(tmp_path / "w.csv", [("x", *line[1:]) for line in table[1:]], ",".join(table[0]))
    records = read_responses([tmp_path / "w.csv"], wide=True)
    assert agree(check(records, scale=Scale(), rules=Rules())[1], rows)
    assert records.unused == ("Timestamp",)


def test_questions_of_a_form_are_described_by_a_table(tmp_path, rows, caplog):
    rows = [(*row[:4], "A" if row[1] < "S03" else "B") for row in rows]
    table, columns, _ = wide_of(rows, lambda item, question: '"Which, of A and B?"')
    table[0][2] = "First"
    key = [(index + 3, item, question, "A" if item < "S03" else "B") for index, (item, question) in enumerate(columns)]
    key[0] = ("first", *key[0][1:])
    write_csv(tmp_path / "key.csv", key, "Column,Item,Question,Ours is")
    write_csv(tmp_path / "w.csv", [line[2:] for line in table[1:]], ",".join(table[0][2:]))
    with pytest.raises(ValueError, match="has no columns '13'; expected one of 'First', 'Which, of A and B"):
        read_responses([tmp_path / "w.csv"], columns=tmp_path / "key.csv")
    write_csv(tmp_path / "w.csv", table[1:], ",".join(table[0]))
    assert agree(judged(tmp_path / "w.csv", columns=tmp_path / "key.csv")[1], rows)
    with pytest.raises(ValueError, match=r"no column says which set .* 'Timestamp', .*ITEM:QUESTION.*--columns FILE"):
        read_responses([tmp_path / "w.csv"], wide=True)


def test_mixed_scales_are_refused(tmp_path):
    rows = answer_rows()
    mixed = [(*row[:3], row[3] * 20, row[4]) if row[0] < "P03" else row for row in rows]
    with pytest.raises(ValueError, match=r"'style' has answers from 1 to 80 where the scale is 1 to 5"):
        judged(write_csv(tmp_path / "r.csv", mixed))
    wide = [(*row[:3], row[3] * 20, row[4]) for row in rows]
    _, (style,) = judged(write_csv(tmp_path / "s.csv", wide), scale=Scale(0.0, 120.0))
    assert np.abs(style.deviations).max() <= 60


@pytest.mark.parametrize(("shift", "found"), [(-1, "0 to 4"), (1, "2 to 6")])
def test_a_shifted_scale_is_refused_however_few_of_its_answers_are_outside(tmp_path, shift, found):
    outer = 1 if shift < 0 else 5
    rows = [(*row[:3], 2 + place % 3 + shift, row[4]) for place, row in enumerate(answer_rows())]
    rows[:2] = [(*row[:3], score + shift, row[4]) for row, score in zip(rows[:2], (outer, 6 - outer), strict=True)]
    told = f"answers from {found} where the scale is 1 to 5.* --label={outer + shift}=NA"
    with pytest.raises(ValueError, match=told):
        judged(write_csv(tmp_path / "r.csv", rows))


def test_any_file_says_the_scene_of_a_set_and_who_answered_nothing_is_not_counted(tmp_path):
    rows = answer_rows()
    known = [(*row, f"of {row[1]}", "ink") for row in rows if row[0] == "P00"]
    write_csv(tmp_path / "known.csv", known, "participant,item,question,score,ours_is,scene,style")
    write_csv(
        tmp_path / "rest.csv", [*rows[len(known) :], ("NOBODY", "S00", "style", "", "A"), ("", "", "style", "", "")]
    )
    for order in (["known.csv", "rest.csv"], ["rest.csv", "known.csv"]):
        records = read_responses([tmp_path / name for name in order])
        checks, (style,) = check(records, scale=Scale(), rules=Rules())
        assert style.item_scenes == tuple(f"of {name}" for name in style.item_names)
        assert checks.participants_read == len({row[0] for row in rows}) and not checks.exclusions
        notes = " ".join(checks.notes)
        assert "1 people gave no answer at all" in notes and "NOBODY" in notes and "are not known" not in notes


def test_ratings_of_ours_alone_are_told(tmp_path):
    rows = [(*row[:4], "ours") for row in answer_rows()]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,method")
    with pytest.raises(ValueError, match=r"no answers are left of \d+: nobody rated both methods, ours and theirs"):
        judged(path)


def test_nothing_left_is_said(tmp_path):
    rows = [("P1", "S1", "style", 3, "A", ""), ("P1", "check", "style", 1, "", 5)]
    path = write_csv(tmp_path / "r.csv", rows, "participant,item,question,score,ours_is,expected")
    with pytest.raises(ValueError, match=r"no answers are left of 2: 1 participant\(s\) with more than 0 attention"):
        judged(path)


def test_answers_on_one_side_only_are_noted(tmp_path):
    checks, _ = judged(write_csv(tmp_path / "r.csv", [(*row[:4], "A") for row in answer_rows()]))
    assert "always shown as A" in checks.notes[0]


def test_a_second_header_is_named(tmp_path):
    path = write_csv(tmp_path / "r.csv", [("", "S1", "style", "Response", "A"), *answer_rows()])
    path.write_text(path.read_text().replace("\n", "\n\n", 1))  # rows are counted as a spreadsheet shows them
    with pytest.raises(ValueError, match=r"without a score are 'Response' \(1\): delete row 3 if it is no participant"):
        judged(path)


def test_answers_of_a_shorter_scale_are_noted(tmp_path):
    rows = [(*row[:3], 1 + row[3] % 2, "AB"[place % 2]) for place, row in enumerate(answer_rows())]
    checks, _ = judged(write_csv(tmp_path / "r.csv", rows))
    assert checks.notes[0].startswith("All answers to style are on one half of the scale of 1 to 5, whichever side")
    checks, _ = judged(write_csv(tmp_path / "r.csv", rows), scale=Scale(1.0, 2.0))
    assert not any("one half" in note for note in checks.notes)
