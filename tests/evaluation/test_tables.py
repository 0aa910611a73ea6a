"""Tables say the same in three forms, and what is not comparable says so in each."""

import csv
import io
import json
import math
from dataclasses import replace

import pytest

from anystyle.contracts.protocol import Evaluation, Row
from anystyle.evaluation import record
from anystyle.evaluation.tables import STAND_IN, Table, escape_latex, escape_markdown, number

FOUND = Evaluation(
    scores={"art_fid": 30.125, "change": 0.25, "warp": math.nan},
    n=8,
    better={"art_fid": "lower", "change": "lower"},
    groups={"scene Train": {"art_fid": 20.0, "change": 0.2}, "scene M60": {"art_fid": 40.25, "change": 0.3}},
    rows=(Row("Train", "00", {"art_fid": 1.0, "change": 0.1}), Row("Train", "a,b", {"change": math.nan})),
    stand_ins={"art_fid": "texture"},
    provenance={"warnings": ["few images"]},
)
KNOWN = {"protocol": "paper", "variant": "reference", "seconds": 3.2, "machine": "a machine"}


def test_what_is_written_is_read_again(tmp_path):
    record.write(FOUND, tmp_path, KNOWN)
    stored = json.loads((tmp_path / "metrics.json").read_text())
    assert stored["art_fid"] == 30.125 and stored["warp"] is None
    assert stored["provenance"]["n"] == 8 and stored["provenance"]["protocol"] == "paper"
    rows = csv.DictReader((tmp_path / "metrics.csv").read_text().splitlines())
    cells = [(row["scene"], row["style"], row["art_fid"], row["change"]) for row in rows]
    assert cells == [("Train", "00", "1.0", "0.1"), ("Train", "a,b", "", "")]
    read = record.read(tmp_path)
    assert read.scores["art_fid"] == 30.125 and math.isnan(read.scores["warp"])
    assert read.scenes == {"Train": {"art_fid": 20.0, "change": 0.2}, "M60": {"art_fid": 40.25, "change": 0.3}}
    assert read.stand_ins == {"art_fid": "texture"} and read.better["change"] == "lower"


def test_every_form_names_the_stand_ins(tmp_path):
    record.write(FOUND, tmp_path, KNOWN)
    for name in ("metrics.csv", "table.md", "table.tex"):
        assert STAND_IN in (tmp_path / name).read_text(), name
    lines = (tmp_path / "table.md").read_text().splitlines()
    scores = {line.split("|")[1].strip() for line in lines if line.startswith("| ")}
    assert {"art_fid ↓ †", "change ↓"} < scores
    assert f"† {STAND_IN} with published scores: art_fid by texture." in "\n".join(lines)
    record.write(Evaluation(scores={"change": 0.25}, n=1), tmp_path, KNOWN)
    assert all(STAND_IN not in (tmp_path / name).read_text() for name in ("metrics.csv", "table.md", "table.tex"))


def test_groups_that_outnumber_the_scores_are_rows():
    table = record.summary(replace(FOUND, groups={f"scene {name}": {"art_fid": 20.0} for name in "ABC"}))
    assert table.columns[:3] == ("", "art_fid ↓ †", "change ↓")
    assert [row[:2] for row in table.rows[1:]] == [("A", "20"), ("B", "20"), ("C", "20")]


def test_what_is_no_evaluation_is_told_apart(tmp_path):
    assert record.read(tmp_path) is None
    (tmp_path / "metrics.json").write_text('{"train/loss": 0.5}')
    assert record.read(tmp_path) is None
    (tmp_path / "metrics.json").write_text('{"train/loss": 0.5')
    with pytest.raises(ValueError, match=r"metrics\.json is not a valid file of scores; evaluate again"):
        record.read(tmp_path)


def test_markdown_is_a_table_whatever_the_words():
    made = Table(("a|b", "c"), (("x\ny", "1"), ("long word", "22")), caption="Title", notes=("note",))
    title, _, *lines = made.markdown().splitlines()
    assert title == "**Title**" and [len(line) for line in lines[:4]] == [len(lines[0])] * 4
    assert lines[0] == r"| a\|b      | c   |" and lines[2].startswith("| x y ")
    assert lines[1] == "|-----------|----:|" and lines[-1] == "note"


def test_latex_escapes_what_would_be_commands():
    assert escape_latex(r"50% a_b & {c} \d $e #f ~^ ↓ ↑") == (
        r"50\% a\_b \& \{c\} \textbackslash{}d \$e \#f \textasciitilde{}\textasciicircum{} $\downarrow$ $\uparrow$"
    )
    made = Table(("name", "x_y ↓"), (("a & b", "1"),)).latex()
    assert r"name & x\_y $\downarrow$ \\" in made and r"a \& b & 1 \\" in made
    assert made.count(r"\begin{") == made.count(r"\end{") == 2


def test_markdown_shows_texts_literally_and_leaves_plain_ones_alone():
    assert escape_markdown("<b> & *x* `y` [a](b) _it_ \\") == r"&lt;b&gt; &amp; \*x\* \`y\` [a\](b) \_it\_ \\"
    assert escape_markdown("warp_rmse ↓ (1 + 2) [1] a=[b,c]") == "warp_rmse ↓ (1 + 2) [1] a=[b,c]"


def test_words_stand_at_the_left_and_scores_at_the_right():
    made = Table(("score", "all", "note"), (("fid ↓", "1.5 ± 0.1", "stand-in"), ("psnr ↑", "–", "")), notes=("“all”",))
    assert made.markdown().splitlines()[1] == "|--------|----------:|----------|"
    assert r"\begin{tabular}{lrl}" in made.latex() and "``all''" in made.latex()


def test_numbers_in_four_digits():
    assert [number(value) for value in (0.0, 12.3456, 0.070123, 1234.5, 123456.0, 2e-5, -3.14159, None, math.nan)] == [
        "0", "12.35", "0.07012", "1234", "1.23e+05", "2.00e-05", "-3.142", "–", "–"
    ]  # fmt: skip


def test_no_spreadsheet_takes_a_text_for_a_formula():
    risky = ("=HYPERLINK(1)", "+a", "-b", "@SUM(1)", "\t=1", "\n=1", "\r=1", "a\r=1")
    texts = (*risky, "plain", "a=b", "-1.5", "+2", "1e-3", "")
    (row,) = csv.reader(io.StringIO(Table(texts, ()).csv(), newline=""))
    assert row == [*(f"'{text}" for text in texts[:6]), "' =1", "a =1", *texts[8:]]
    # Only there: the same text in Markdown and LaTeX is what it was.
    assert "'" not in Table(texts[:4], ()).markdown()
