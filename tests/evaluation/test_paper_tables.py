"""The paper's tables: every printed cell is stored, shown by ``anystyle report --paper``, and recomputed."""

import csv
import json
from collections import Counter

import pytest

from anystyle.commands import report as command
from anystyle.evaluation import published_figures as published
from anystyle.evaluation import record
from anystyle.evaluation.base import Evaluation
from real_data import ROOT

TRANSCRIPT = ROOT.parent / "reference" / "paper_tables.json"
PAPER = "AnyStyle, arXiv:2602.04043"
VARIANTS = {"head": ", Head", "agg": ", Agg"}


@pytest.fixture(scope="module")
def transcript():
    if not TRANSCRIPT.is_file():
        pytest.skip(f"{TRANSCRIPT.name} is absent; ANYSTYLE_TEST_DATA names the folder beside that of reference/")
    return json.loads(TRANSCRIPT.read_text())


@pytest.fixture(scope="module")
def printed(tmp_path_factory):
    """The rows of each table as the command writes them, by variant."""
    out = tmp_path_factory.mktemp("tables")
    assert command.main(["--paper", "all", "--out", str(out)]) == 0
    return {
        path.stem: {row["variant"]: row for row in csv.DictReader(path.read_text().splitlines())}
        for path in out.glob("*.csv")
    }


def title(table, cell):
    # Table 2 names the full model without a variant.
    variant = "" if (table, cell["variant"]) == ("table_2", "agg") else VARIANTS.get(cell["variant"], "")
    ablation = f": {cell['ablation_printed']}" if "ablation_printed" in cell else ""
    return f"{cell['method']}{variant}{ablation}"


def column(cell):
    scene = "" if cell["scene"] in (None, "all") else cell["scene"]
    arrow = {"higher": " ↑", "lower": " ↓", None: ""}[cell["better"]]
    return f"{scene} {cell['metric']}{arrow}".strip()


def test_every_printed_cell_is_in_the_report(transcript, printed):
    num_cells = 0
    for table in transcript["tables"]:
        for cell in table["rows"]:
            text = printed[table["id"]][title(table["id"], cell)][column(cell)]
            mark = {"best": " (1st)", "second": " (2nd)", None: ""}[cell["marked"]]
            assert text == cell["printed"] + mark, (table["id"], cell)
            num_cells += 1
    assert num_cells == 60 + transcript["counts"]["total_numeric"]


def test_values_and_origins_are_those_of_the_transcript(transcript):
    stored = {
        (item.table, item.method, item.scene, item.figure): item for item in published.load() if item.source == PAPER
    }
    for table in transcript["tables"]:
        for cell in table["rows"]:
            scene = "" if cell["scene"] in (None, "all") else cell["scene"]
            item = stored[table["id"], title(table["id"], cell), scene, cell["metric"]]
            assert item.value == pytest.approx(float(cell["value"]))
            if cell.get("origin") == "imported_from_stylos_as_stated":
                assert "Stylos paper" in item.origin
    assert {name: entry["better"] for name, entry in transcript["metrics"].items()} == published.better()


def test_the_bundled_tables_are_whole():
    counts = Counter(item.table for item in published.load() if item.source == PAPER)
    assert counts == {"table_1": 60, "table_2": 90, "table_3": 48, "table_4": 176, "table_5": 100, "table_6": 100}
    seconds = {item.method: item.value for item in published.load() if item.figure == "time_s"}
    assert (seconds["StyleGaussian"], seconds["AnyStyle (image)"], seconds["Stylos"]) == (9900, 0.07, 0.05)


def test_ours_stand_below_the_papers_rows_and_what_does_not_add_up_is_said(tmp_path, capsys):
    groups = {"scene Train": {"art_score": 1.5, "art_fid": 30.25}, "scene garden": {"art_fid": 31.5}}
    found = Evaluation({"art_fid": 30.9}, 4, groups=groups, times={"time_s": 2.5})
    (tmp_path / "mine").mkdir()
    record.write(found, tmp_path / "mine", {"protocol": "paper"})
    assert command.main([str(tmp_path / "mine"), "--paper", "table_2", "--out", str(tmp_path)]) == 0
    shown = capsys.readouterr().out
    rows = {row["variant"]: row for row in csv.DictReader((tmp_path / "table_2.csv").read_text().splitlines())}
    assert list(rows)[-1] == "mine" and rows["mine"]["source"] == "computed here"
    assert [rows["mine"][name] for name in ("Train art_fid ↓", "Garden art_fid ↓", "time_s ↓", "M60 art_fid ↓")] == [
        "30.25", "31.5", "2.5", "–"
    ]  # fmt: skip
    for said in ("Train 27.74, not 34.69", "Three of its marks", "M60 24.16 and 24.34", "wall time of one pass"):
        assert said in shown, said
    assert (tmp_path / "table_2.tex").is_file() and (tmp_path / "table_2.md").is_file()
