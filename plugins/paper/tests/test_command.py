"""`anystyle report`: four forms, and one line for what cannot be reported."""

import csv
import json
import math
import sys

import numpy as np
import pytest
from matplotlib.container import ErrorbarContainer
from PIL import Image
from scipy import stats

from anystyle.cli.run import run
from anystyle.contracts.protocol import Evaluation, Row
from anystyle.evaluation import plots, record
from anystyle.evaluation.tables import STAND_IN
from anystyle_paper import bars, command
from anystyle_paper.run_table import Line
from tests.support.program import failing


@pytest.fixture
def evaluated(tmp_path):
    found = Evaluation(
        {"art_fid": 321.5, "psnr": 20.25}, 4, better={"art_fid": "lower"}, stand_ins={"art_fid": "texture"}
    )
    folder = tmp_path / "evaluated"
    folder.mkdir()
    record.write(found, folder, {"protocol": "paper"})
    return folder


def test_every_form_is_written(evaluated, tmp_path):
    command.Report()([str(evaluated), "--with-published", "--out", str(tmp_path / "out")])
    for name in ("table.md", "table.csv", "table.tex"):
        text = (tmp_path / "out" / name).read_text()
        assert STAND_IN in text and "published [1]" in text and "321.5" in text, name
    rows = list(csv.DictReader((tmp_path / "out" / "table.csv").read_text().splitlines()))
    assert {row["source"] for row in rows if row["art_fid"] == "321.5"} == {STAND_IN}
    with Image.open(tmp_path / "out" / "scores.png") as plot:
        assert plot.width > 300 and len(np.unique(np.asarray(plot.convert("L")))) > 4


@pytest.fixture
def drawn(monkeypatch):
    """The figures, in place of their files."""
    figures = []
    monkeypatch.setattr("anystyle.evaluation.plots.save", lambda figure, path: figures.append(figure))
    return figures


def test_the_plot_has_a_row_for_each_variant_and_says_below_a_panel_what_stands_in(evaluated, tmp_path, drawn):
    command.Report()([str(evaluated), "--out", str(tmp_path / "out")])
    art_fid, psnr = drawn[0].axes
    assert [label.get_text() for label in art_fid.get_yticklabels()] == ["evaluated"]
    assert [axis.patches[0].get_width() for axis in (art_fid, psnr)] == [321.5, 20.25]
    assert [axis.get_xlabel() for axis in (art_fid, psnr)] == [STAND_IN, ""]
    assert art_fid.patches[0].get_facecolor() != psnr.patches[0].get_facecolor()


def test_seeds_are_dots_with_the_interval_of_the_table(tmp_path, drawn):
    values = [10.0, 12.0, 14.5]
    lines = [
        Line("base", "ours", "", {("", "psnr"): (*values, math.nan)}),
        Line("one", "ours", "", {("", "psnr"): (11.0,)}),
    ]
    assert bars.draw(lines, [("", "psnr")], {}, tmp_path / "scores.png")
    (axis,) = drawn[0].axes
    (interval,) = [container for container in axis.containers if isinstance(container, ErrorbarContainer)]
    low, high = stats.t.interval(0.95, 2, loc=np.mean(values), scale=stats.sem(values))
    np.testing.assert_allclose(interval[2][0].get_segments()[0][:, 0], [low, high])
    assert [line.get_xdata().tolist() for line in axis.lines if line.get_marker() == "o"] == [values]
    assert [bar.get_width() for bar in axis.patches] == [np.mean(values), 11]
    assert axis.get_xlim()[1] > high and "95 % t interval" in drawn[0].get_supxlabel()


def test_the_line_of_a_scene_in_the_spread_is_its_score_in_the_table(tmp_path, drawn):
    rows = tuple(Row("street", style, {"art_fid": value}) for style, value in (("a", 30.0), ("b", 50.0)))
    for facts, groups in (({"scenes": ["street"]}, {}), ({}, {"scene street": {"art_fid": 25.0}})):
        plots.spread(
            Evaluation({"art_fid": 25.0}, 2, groups=groups, rows=rows, provenance=facts), tmp_path / "spread.png"
        )
        dots, line = drawn[-1].axes[0].lines
        assert [list(dots.get_xdata()), list(line.get_xdata())] == [[30, 50], [25, 25]]
        assert "as in the table" in drawn[-1].get_supxlabel()
    kinds = (*rows, Row("street", "fit", {"art_fid": 20.0}), Row("street", "stylized, a", {"art_fid": 10.0}))
    scores = {"fit": {"art_fid": 20.0}, "stylized": {"art_fid": 10.0}, "scene street": {}}
    plots.spread(Evaluation({"art_fid": 20.0}, 2, groups=scores, rows=kinds), tmp_path / "spread.png")
    axis = drawn[-1].axes[0]
    assert [text.get_text() for text in axis.get_yticklabels()] == ["street", "fit", "stylized"]
    assert [list(line.get_xdata()) for line in axis.lines[1:]] == [[20.0], [20.0, 20.0], [10.0], [10.0, 10.0]]


def test_without_what_draws_the_tables_are_written_all_the_same(evaluated, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    command.Report()([str(evaluated), "--out", str(tmp_path / "out")])
    assert 'no plot: plots need matplotlib: pip install "anystyle[report]"' in capsys.readouterr().err
    written = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert written == [".anystyle", "table.csv", "table.md", "table.tex"]


def test_what_cannot_be_reported_is_one_line(tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "metrics.json").write_text("{")
    (tmp_path / "infinite").mkdir()
    (tmp_path / "infinite" / "metrics.json").write_text('{"psnr": 1e400, "n": [' + "9" * 400 + "]}")
    (tmp_path / "rows.json").write_text(json.dumps({"rows": 1}))
    cases = {
        "no folder is named": [],
        "there is no folder": [str(tmp_path / "absent")],
        "holds no runs": [str(tmp_path / "empty")],
        "is not a valid file of scores": [str(tmp_path / "broken")],
        "is not a valid file of scores; evaluate again (Number out of range": [str(tmp_path / "infinite")],
        "is not a valid file of published scores": ["--published", str(tmp_path / "rows.json")],
        "unrecognized arguments: --wiht-published. Did you mean '--with-published'?": ["--wiht-published"],
    }
    for told, words in cases.items():
        assert told in failing(lambda words: run(lambda: command.Report()(words)), capsys, *words)
