"""What ``anystyle benchmark`` measures, and that it goes on where it stopped."""

import json

import pytest
import torch

from anystyle.commands import benchmark as command
from anystyle.commands.benchmark import Measured, Results, benchmark, off_line, slope, table


def test_the_slope_is_that_of_the_line_through_the_peaks():
    assert slope({2: 100, 4: 160, 8: 280}) == pytest.approx(30)
    assert slope({2: 100}) == 0
    assert off_line({2: 100, 4: 160, 8: 280}) == pytest.approx(0, abs=1e-9)
    assert off_line({0: 0, 1: 3, 2: 0}) == pytest.approx(2)


def test_the_best_of_several_runs_counts(monkeypatch):
    wall, cpu = iter([1.0, 4.0, 10.0, 12.0, 20.0, 25.0]), iter([0.5, 2.5, 3.0, 4.0, 5.0, 9.0])
    monkeypatch.setattr(command.time, "perf_counter", lambda: next(wall))
    monkeypatch.setattr(command.time, "process_time", lambda: next(cpu))
    runs = []
    assert command.best(lambda: runs.append(1), 3, torch.device("cpu")) == (2.0, 1.0)
    assert len(runs) == 3


def test_rows_that_are_there_are_not_measured_again(tmp_path):
    rows = [Measured("encode", 1.0, 2.0, "once a scene")]
    setting = {"views": [2]}
    Results(tmp_path / "b.json", setting).get("passes", lambda: rows)

    def never():
        raise AssertionError("measured again")

    again = Results(tmp_path / "b.json", setting).get("passes", never)
    assert again[0]["seconds"] == 1.0
    other = Results(tmp_path / "b.json", {"views": [4]}).get("passes", lambda: [Measured("encode", 3.0, 3.0)])
    assert other[0]["seconds"] == 3.0
    (tmp_path / "broken.json").write_text("{")
    with pytest.raises(ValueError, match="is no benchmark"):
        Results(tmp_path / "broken.json", setting)


def test_the_command_measures_the_default_model_and_writes_one_table(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(command, "peak_memory", lambda words, views, size: (300 + 10 * views) * 2**20)
    out = tmp_path / "benchmark.json"
    method = ["method=nnfm", "method.num_steps=1"]
    benchmark(["--views", "2,4", "--size", "56x56", "--repeat", "1", "--out", str(out), *method])
    printed = capsys.readouterr().out
    assert "restyle (2 views)" in printed and "results equal" in printed
    assert "method=nnfm method.num_steps=1" in printed
    assert "render with cpu" in printed and "render with torch" in printed
    assert "10.0 MiB a view." in printed
    stored = json.loads(out.read_text())
    assert {"2 views", "renderers", "method", "memory of 2 views", "memory of 4 views"} == set(stored["rows"])


def test_wrong_words_end_in_one_line():
    for words, message in (
        (["--views", "two"], "takes numbers"),
        (["--views", "0"], "at least 1"),
        (["--size", "56"], "height and width"),
        (["--repeat", "0"], "at least once"),
    ):
        with pytest.raises(ValueError, match=message):
            benchmark(words)


def test_the_table_states_units():
    text = table([{"name": "encode", "seconds": 1.0, "cpu_seconds": 2.0, "instead": "x"}], {2: 2**20, 3: 3 * 2**20})
    assert "| encode | 1.000 | 2.000 | x |" in text and "2.0 MiB a view." in text
    assert "of that line" in table([], {1: 1, 2: 2, 4: 4})
