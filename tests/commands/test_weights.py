"""``anystyle weights``: the table, and judging a file."""

import argparse
import datetime
import functools
import os
import re
from collections import OrderedDict
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from anystyle.pipeline.weights import load_reference
from anystyle.vision import weights
from tests.support.program import program
from tests.support.refusals import raises_line
from tests.support.weights_cases import small_checkpoint


@pytest.fixture
def cli(tmp_path):
    """Runs ``anystyle weights`` with words; returns exit status, output and error output."""
    return lambda *words: program(["weights", *map(str, words)], tmp_path, os.environ)


def refused(cli, *words: object, told: str):
    status, _, err = cli(*words)
    assert status == 2
    assert re.search(told, err), err
    assert err.count("\n") == 1 and "Traceback" not in err


def test_the_table_says_all_of_every_file(cli, tmp_path, monkeypatch):
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path))
    (tmp_path / "longclip-B-32.pt").write_bytes(b"here")
    status, out, _ = cli()
    assert status == 0 and cli("list")[1] == out
    blocks = {block.partition(":")[0]: block for block in re.split(r"\n(?=\w+: (?:found|missing))", out)}
    assert blocks.keys() == weights.files().keys()
    for name, block in blocks.items():
        entry = weights.files()[name]
        for part in (entry.purpose, entry.license, entry.source, (entry.sha256 or "")[:8]):
            assert part in block
    assert f"  file     {tmp_path / 'longclip-B-32.pt'}" in blocks["longclip_b32"]
    assert blocks["anysplat"].startswith("anysplat: missing, 4.76 GB of tensors (computed)\n")
    assert blocks["raft_things"].startswith("raft_things: missing, 21.1 MB\n")
    assert f"  looked   {tmp_path / 'anysplat.safetensors'}" in blocks["anysplat"]
    assert blocks["tiny_branch"].startswith("tiny_branch: found") and "ANYSTYLE_WEIGHTS" in out


def test_rows_are_chosen_by_name(cli):
    status, out, _ = cli("list", "vgg19")
    assert status == 0 and out.startswith("vgg19: ") and "alexnet" not in out
    refused(cli, "list", "vg19", told=r"is named 'vg19'\. Did you mean 'vgg19'\?")
    refused(cli, "verfy", told=r"Did you mean 'verify'\?")


def test_what_a_file_holds(cli, tmp_path):
    save_file(small_checkpoint("head"), tmp_path / "it.safetensors")
    status, out, err = cli("verify", tmp_path / "it.safetensors")
    assert status == 0, err
    assert "none is published" in out and "float32" in out
    assert "branch that anystyle wrote" in cli("verify", "tiny_branch")[1]
    assert "as published" in cli("verify", "magenta_transform")[1]
    save_file({"a": torch.tensor([1.0, torch.nan])}, tmp_path / "nan.safetensors")
    refused(cli, "verify", tmp_path / "nan.safetensors", told="is damaged: a holds values")


def test_plain_objects_beside_the_tensors_are_passed_over(cli, tmp_path):
    state = small_checkpoint("head")
    beside = {
        "callbacks": {"ModelCheckpoint": {"dirpath": tmp_path, "best_model_score": np.float64(0.5), "seen": {1, 2}}},
        "hyper_parameters": argparse.Namespace(root=Path("data"), started=datetime.datetime(2026, 1, 1), lr=1e-4),
        "loops": [OrderedDict(step=3), functools.partial(int, base=8)],
    }
    torch.save({"state_dict": state} | beside, tmp_path / "lightning.ckpt")
    status, out, err = cli("verify", tmp_path / "lightning.ckpt")
    assert status == 0, err
    assert f"{len(state)} tensors" in out
    read = weights.read(tmp_path / "lightning.ckpt")
    assert read.keys() == state.keys() and all(torch.equal(read[key], tensor) for key, tensor in state.items())


def evil(path: Path):
    class Evil:
        def __reduce__(self) -> tuple:
            return (print, ("EXECUTED",))

    torch.save({"state_dict": small_checkpoint("head"), "callbacks": Evil()}, path)


def truncated(path: Path):
    torch.save(small_checkpoint("head"), path)
    path.write_bytes(path.read_bytes()[:20000])


def truncated_safetensors(path: Path):
    save_file(small_checkpoint("head"), path)
    path.write_bytes(path.read_bytes()[:-5000])


def script(path: Path):
    torch.jit.save(torch.jit.trace(torch.nn.Linear(2, 2), torch.zeros(1, 2)), path)


BAD = [
    (evil, "bad.ckpt", r"bad\.ckpt holds code or objects of other programs \(builtins\.print\)"),
    (truncated, "bad.pt", "is not a valid file of weights"),
    (truncated_safetensors, "bad.safetensors", "is not a valid file of weights"),
    (lambda path: path.write_bytes(b"\xff" * 64), "endless.safetensors", "is not a valid file of weights"),
    (lambda path: torch.save({"state_dict": {"a": 3}}, path), "number.pt", "holds no plain state dict"),
    (script, "clip.pt", "TorchScript program; get the state dict"),
]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
@pytest.mark.parametrize(("make", "name", "told"), BAD, ids=[name for _, name, _ in BAD])
def test_bad_files_end_in_one_line(cli, tmp_path, make, name, told):
    make(tmp_path / name)
    refused(cli, "verify", tmp_path / name, told=told)
    with raises_line(ValueError):
        load_reference(tmp_path / name)


def test_another_content_than_the_published_is_refused(cli, tmp_path):
    save_file({"features.34.weight": torch.zeros(512, 512, 3, 3)}, tmp_path / "vgg19.safetensors")
    (tmp_path / "vgg19.safetensors").rename(tmp_path / "vgg19-dcbb9e9d.pth")
    refused(cli, "verify", tmp_path / "vgg19-dcbb9e9d.pth", told=r"the published vgg19 dcbb9e9d…; get it again")
    refused(cli, "verify", tmp_path / "nowhere.pt", told=r"there is no file .*nowhere\.pt")


def test_what_no_hub_has_says_where_to_get_it(cli, tmp_path, monkeypatch):
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path))
    told = r"from https://zenodo\.org/records/18816747 .* put it as anystyle_head\.ckpt"
    refused(cli, "download", "anystyle_head", told=told)
    status, out, _ = cli("download", "tiny_branch")
    assert status == 0 and Path(out.strip()) == weights.find("tiny_branch")
