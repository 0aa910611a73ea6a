"""What ``anystyle profile`` measures."""

import json

import pytest

from anystyle.errors import UserError
from anystyle_benchmark.command_profile import Measured, Profile, table, without_missing


def test_the_command_measures_the_default_model_and_writes_one_table(tmp_path, capsys):
    out = tmp_path / "profile.json"
    method = ["method=nnfm", "method.num_steps=1"]
    Profile()(["--views", "2,4", "--size", "56x56", "--repeat", "1", "--out", str(out), *method])
    printed = capsys.readouterr().out
    assert "| restyle |" in printed and "results equal" in printed
    assert "method=nnfm method.num_steps=1" in printed
    assert "render with cpu" in printed and "render with torch" in printed
    stored = json.loads(out.read_text())
    assert 2**20 < stored["peaks"]["2"] < stored["peaks"]["4"] and stored["rows"][0]["name"] == "encode"


def test_weights_that_are_missing_are_left_out(capsys, monkeypatch):
    monkeypatch.delenv("ANYSTYLE_WEIGHTS", raising=False)
    words = ["model=anystyle_head"]
    assert without_missing(words) == [f"weights.{part}=null" for part in ("backbone", "style_encoder", "branch")]
    assert "the weights 'longclip_b32' are missing: the style_encoder is profiled as" in capsys.readouterr().err
    assert without_missing(["model=tiny"]) == []


def test_wrong_words_end_in_one_line():
    for words, message in (
        (["--views", "two"], "takes numbers"),
        (["--views", "0"], "at least 1"),
        (["--size", "56"], "height and width"),
        (["--repeat", "0"], "at least once"),
    ):
        with pytest.raises(UserError, match=message):
            Profile()(words)


def test_the_table_states_units():
    text = table([Measured("encode", 1.0, 2.0, "x")], {2: 2**20, 4: 3 * 2**20})
    assert "| encode | 1.000 | 2.000 | x |" in text
    assert "1.0 MiB per view" in text
