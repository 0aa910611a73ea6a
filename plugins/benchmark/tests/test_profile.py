"""What ``anystyle profile`` measures."""

import json

import pytest
import torch

from anystyle.errors import UserError
from anystyle_benchmark.command_profile import Measured, Profile, agreement, table, without_missing


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


def test_a_model_that_reads_the_tokens_of_images_is_measured(tmp_path, capsys):
    trunk = ("dim=32", "depth=2", "heads=2", "resolution=32")
    decoder = ("decoder_dim=24", "decoder_depth=4", "decoder_heads=2", "features=16", "channels=[8,8,8,8]", "hidden=8")
    words = [*(f"style_encoder.{word}" for word in trunk), *(f"backbone.{word}" for word in (*trunk, *decoder))]
    weights = [f"weights.{part}=null" for part in ("backbone", "style_encoder", "branch")]
    Profile()(["--views", "2", "--repeat", "1", "--out", str(tmp_path / "x.json"), "model=styl3r", *words, *weights])
    assert "results equal" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("other", "words"),
    [([1.0, 2.0], "equal"), ([1.0, 4.0], "differ by 5e-01 of the largest value"), ([1.0], "DIFFER in number")],
)
def test_results_agree_or_by_how_much_they_do_not(other, words):
    assert agreement([torch.tensor([1.0, 2.0])], [torch.tensor(other)]) == words


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
