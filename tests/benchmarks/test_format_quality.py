"""The script that measures formats runs, on views of half the size."""

import pytest

from benchmarks import format_quality
from benchmarks.format_quality import READERS


@pytest.mark.slow
def test_the_table_of_formats_has_a_row_for_each(monkeypatch, capsys):
    monkeypatch.setattr("sys.argv", ["format_quality.py", "--size", "56", "--views", "2"])
    format_quality.main()
    rows = {
        cells[1].strip(" `"): cells
        for line in capsys.readouterr().out.splitlines()
        if len(cells := line.split("|")) > 5
    }
    assert {*READERS, "html`, 4 styles"} <= set(rows)
    assert rows["ply"][4].strip() == rows["glb"][4].strip() == "identical"
    assert all(float(rows[name][4]) > 45 for name in ("spz", "sog", "splat"))
