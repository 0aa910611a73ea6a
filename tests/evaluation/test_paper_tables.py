"""The paper's tables: every printed cell is stored, shown by ``anystyle report --paper``, and recomputed."""

import csv
import json
from collections import Counter

import pytest

from anystyle.commands import report as command
from anystyle.contracts.protocol import Evaluation
from anystyle.evaluation import published_figures as published
from anystyle.evaluation import record
from tests.support.real_data import ROOT

TRANSCRIPT = ROOT.parent / "reference" / "paper_tables.json"
PAPER = "AnyStyle, arXiv:2602.04043"
VARIANTS = {"head": ", Head", "agg": ", Agg"}


@pytest.fixture(scope="module")
def transcript():
    if not TRANSCRIPT.is_file():
        pytest.skip(f"{TRANSCRIPT.name} is absent; ANYSTYLE_TEST_DATA names the folder beside that of reference/")
    return json.loads(TRANSCRIPT.read_text())


@pytest.fixture(scope="module")
def tables(tmp_path_factory):
    """All tables as the command writes them."""
    out = tmp_path_factory.mktemp("tables")
    assert command.main(["--paper", "all", "--out", str(out)]) == 0
    return out


def rows_of(path):
    rows = {(row.get("block", ""), row["Method"]): row for row in csv.DictReader(path.read_text().splitlines())}
    if path.stem == "table_1":  # Methods with the same properties share a row.
        return {("", method): row for (_, methods), row in rows.items() for method in methods.split(", ")}
    return rows


def title(table, cell):
    # Table 2 names the full model without a variant.
    variant = "" if (table, cell["variant"]) == ("table_2", "agg") else VARIANTS.get(cell["variant"], "")
    ablation = f": {cell['ablation_printed']}" if "ablation_printed" in cell else ""
    return f"{cell['method']}{variant}{ablation}"


def place(table, cell):
    """The block and the method of a cell's row, and its column."""
    scene = "" if cell["scene"] in (None, "all") else cell["scene"]
    arrow = {"higher": " ↑", "lower": " ↓", None: ""}[cell["better"]]
    form = published.tables()[table]
    column = f"{scene} {form.heads[cell['metric']]}{arrow}".strip()
    method, _, ablation = title(table, cell).partition(": ")
    block = next((block for block, figures in form.blocks.items() if cell["metric"] in figures), "")
    return ((method, ablation) if ablation else (block, method)), column


def test_every_printed_cell_is_in_the_report(transcript, tables):
    printed = {path.stem: rows_of(path) for path in tables.glob("*.csv")}
    num_cells = 0
    for table in transcript["tables"]:
        for cell in table["rows"]:
            row, column = place(table["id"], cell)
            text = printed[table["id"]][row][column]
            mark = {"best": " (1st)", "second": " (2nd)", None: ""}[cell["marked"]]
            said = {"yes": "✓", "no": "✗"}.get(cell["printed"], cell["printed"])
            assert text == said + mark, (table["id"], cell)
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
    *_, (place, ours) = rows_of(tmp_path / "table_2.csv").items()
    assert place == ("", "mine (computed here)")
    assert [ours[name] for name in ("Train FID ↓", "Garden FID ↓", "Time ↓", "M60 FID ↓")] == [
        "30.25", "31.5", "2.5 s", "–"
    ]  # fmt: skip
    for said in ("Train 27.74, not 34.69", "Three of its marks", "M60 24.16 and 24.34", "wall time of one pass"):
        assert said in shown, said
    assert (tmp_path / "table_2.tex").is_file() and (tmp_path / "table_2.md").is_file()


def test_latex_has_the_rules_blocks_and_marks_of_the_page(tables):
    table_2, table_4 = ((tables / f"table_{number}.tex").read_text() for number in (2, 4))
    assert r"\multicolumn{2}{c}{Train} & \multicolumn{2}{c}{Truck}" in table_2
    assert r"\cmidrule(lr){2-3} \cmidrule(lr){4-5}" in table_2
    assert r"\underline{9.50}" in table_2 and r"\textbf{22.15}" in table_2
    assert table_2.index("SGSST") < table_2.index("\\midrule\nStyl3R") < table_2.index("\\midrule\nAnyStyle (image)")
    near, far = (rf"\multicolumn{{9}}{{c}}{{\textit{{{name}-range consistency}}}}" for name in ("Short", "Long"))
    assert table_4.count("GT images") == 2 and table_4.index(near) < table_4.index("GT images") < table_4.index(far)
