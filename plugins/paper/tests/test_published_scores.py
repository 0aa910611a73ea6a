"""The paper's tables: every printed cell is stored, with its mark and its origin."""

import json
from collections import Counter

import pytest

from anystyle_paper import published_scores as published
from tests.support.real_data import ROOT

TRANSCRIPT = ROOT.parent / "reference" / "paper_tables.json"
VARIANTS = {"head": ", Head", "agg": ", Agg"}


def of_the_paper():
    return [item for item in published.load() if item.source.startswith("AnyStyle, arXiv")]


def title(table, cell):
    # Table 2 names the full model without a variant.
    variant = "" if (table, cell["variant"]) == ("table_2", "agg") else VARIANTS.get(cell["variant"], "")
    ablation = f": {cell['ablation_printed']}" if "ablation_printed" in cell else ""
    return f"{cell['method']}{variant}{ablation}"


def test_every_printed_cell_is_stored_with_its_mark_and_its_origin():
    if not TRANSCRIPT.is_file():
        pytest.skip(f"{TRANSCRIPT.name} is absent; ANYSTYLE_TEST_DATA names the folder beside that of reference/")
    transcript = json.loads(TRANSCRIPT.read_text())
    stored = {(item.table, item.method, item.scene, item.score): item for item in of_the_paper()}
    cells = [(table["id"], cell) for table in transcript["tables"] for cell in table["rows"]]
    for table, cell in cells:
        scene = "" if cell["scene"] in (None, "all") else cell["scene"]
        item = stored[table, title(table, cell), scene, cell["metric"]]
        assert item.value == pytest.approx(float(cell["value"]))
        assert item.printed == {"yes": "✓", "no": "✗"}.get(cell["printed"], cell["printed"])
        assert item.mark == {"best": "1st", "second": "2nd", None: ""}[cell["marked"]]
        if cell.get("origin") == "imported_from_stylos_as_stated":
            assert "Stylos paper" in item.origin
    assert len(cells) == len(stored) == 60 + transcript["counts"]["total_numeric"]
    assert {name: entry["better"] for name, entry in transcript["metrics"].items()} == published.better()


def test_the_bundled_tables_are_whole():
    counts = Counter(item.table for item in of_the_paper())
    assert counts == {"table_1": 60, "table_2": 90, "table_3": 48, "table_4": 176, "table_5": 100, "table_6": 100}
    seconds = {item.method: item.value for item in published.load() if item.score == "time_s"}
    assert (seconds["StyleGaussian"], seconds["AnyStyle (image)"], seconds["Stylos"]) == (9900, 0.07, 0.05)
