"""``anystyle weights``: the table, judging a file, keeping its tensors alone."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file, save_file
from torch import Tensor

from anystyle.commands import weights as command
from anystyle.commands._run import run
from anystyle.pipeline.weights import load_reference
from anystyle.vision import weights
from anystyle.vision.clip import Clip
from weights_cases import small_checkpoint, training_checkpoint

Cli = Callable[..., tuple[int, str, str]]


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Runs ``anystyle weights`` with words; returns exit status, output and error output."""

    def call(*words: object) -> tuple[int, str, str]:
        try:
            run(lambda: command.main([str(word) for word in words]))
        except SystemExit as left:
            status = left.code
        else:
            status = 0
        out, err = capsys.readouterr()
        assert isinstance(status, int)
        return status, out, err

    return call


def refused(cli: Cli, *words: object, told: str) -> None:
    status, out, err = cli(*words)
    assert status == 2 and out == ""
    assert re.search(told, err), err
    assert err.count("\n") == 1 and "Traceback" not in err


# The table


def test_the_table_says_all_of_every_file(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
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
    assert blocks["anysplat"].startswith("anysplat: missing, 4.76 GB")
    assert f"  looked   {tmp_path / 'anysplat.safetensors'}" in blocks["anysplat"]
    assert blocks["tiny_branch"].startswith("tiny_branch: found")
    assert "ANYSTYLE_WEIGHTS" in out


def test_rows_are_chosen_by_name(cli: Cli) -> None:
    status, out, _ = cli("list", "vgg19")
    assert status == 0 and out.startswith("vgg19: ") and "alexnet" not in out
    refused(cli, "list", "vg19", told=r"is named 'vg19'\. Did you mean 'vgg19'\?")
    refused(cli, "verfy", told=r"Did you mean 'verify'\?")


# Judging a file


@pytest.mark.parametrize(
    ("placement", "prefix", "told"),
    [
        (None, "encoder.", ["backbone=anysplat", "float32"]),
        ("head", "model.encoder.", ["backbone=anysplat", "placement=head", "an addition to the style encoder"]),
        ("full", "", ["backbone=anysplat", "a style branch of placement=full", "an addition to the style encoder"]),
    ],
)
def test_checkpoints_are_recognised(cli: Cli, tmp_path: Path, placement: str | None, prefix: str, told: list) -> None:
    save_file(small_checkpoint(placement, prefix), tmp_path / "it.safetensors")
    status, out, err = cli("verify", tmp_path / "it.safetensors")
    assert status == 0, err
    assert "it.safetensors is whole" in out and "sha256" in out
    for part in told:
        assert part in out


def test_an_initialisation_is_told_from_the_whole_network(cli: Cli, tmp_path: Path) -> None:
    """VGGT's file: no Gaussian head, and heads that AnySplat drops."""
    state = {key: tensor for key, tensor in small_checkpoint(None).items() if not key.startswith("gaussian_param")}
    state |= {"point_head.norm.weight": torch.ones(4), "track_head.tracker.weight": torch.ones(4)}
    save_file(state, tmp_path / "vggt.safetensors")
    status, out, err = cli("verify", tmp_path / "vggt.safetensors")
    assert status == 0, err
    assert "an initialisation of parts of it" in out


def test_clips_and_our_own_files_are_recognised(cli: Cli, tmp_path: Path) -> None:
    clip = Clip(context=77, vocabulary=30, text_width=64, text_layers=1, image_width=64, image_layers=2, dim=8)
    torch.save({**clip.state_dict(), "logit_scale": torch.ones(())}, tmp_path / "clip.pt")
    assert "CLIP or Long-CLIP" in cli("verify", tmp_path / "clip.pt")[1]
    assert "branch that anystyle wrote" in cli("verify", "tiny_branch")[1]
    assert "LPIPS" in cli("verify", "lpips_alex")[1]
    broken = {key: tensor for key, tensor in clip.state_dict().items() if key != "ln_final.weight"}
    torch.save(broken, tmp_path / "broken.pt")
    refused(cli, "verify", tmp_path / "broken.pt", told=r"1 missing \(ln_final\.weight\)")


def evil(path: Path) -> None:
    class Evil:
        def __reduce__(self) -> tuple:
            return (print, ("EXECUTED",))

    torch.save({"state_dict": small_checkpoint("head"), "callbacks": Evil()}, path)


def truncated(path: Path) -> None:
    torch.save(small_checkpoint("head"), path)
    path.write_bytes(path.read_bytes()[:20000])


def truncated_safetensors(path: Path) -> None:
    save_file(small_checkpoint("head"), path)
    path.write_bytes(path.read_bytes()[:-5000])


def script(path: Path) -> None:
    torch.jit.save(torch.jit.trace(torch.nn.Linear(2, 2), torch.zeros(1, 2)), path)


def foreign(path: Path) -> None:
    save_file({"down_blocks.0.weight": torch.zeros(2)}, path)


def no_tensors(path: Path) -> None:
    torch.save({"state_dict": {"a": 3}}, path)


BAD = [
    (evil, "bad.ckpt", "holds more than tensors"),
    (truncated, "bad.pt", "is truncated or no file of weights"),
    (truncated_safetensors, "bad.safetensors", "is truncated or no safetensors file"),
    (foreign, "bad.safetensors", r"is of no known kind: 1 tensors, such as down_blocks\.0\.weight"),
    (no_tensors, "bad.pt", "holds no plain state dict"),
]


@pytest.mark.parametrize(("make", "name", "told"), BAD, ids=[make.__name__ for make, *_ in BAD])
def test_bad_files_end_in_one_line(cli: Cli, tmp_path: Path, make: Callable, name: str, told: str) -> None:
    make(tmp_path / name)
    refused(cli, "verify", tmp_path / name, told=told)
    refused(cli, "convert", tmp_path / name, tmp_path / "out.safetensors", told=told)
    assert not (tmp_path / "out.safetensors").exists()
    with pytest.raises(ValueError) as caught:
        load_reference(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_a_program_is_no_file_of_weights(cli: Cli, tmp_path: Path) -> None:
    script(tmp_path / "clip.pt")
    refused(cli, "verify", tmp_path / "clip.pt", told="TorchScript program; get the state dict")


def test_another_content_than_the_published_is_refused(cli: Cli, tmp_path: Path) -> None:
    save_file({"features.34.weight": torch.zeros(512, 512, 3, 3)}, tmp_path / "vgg19.safetensors")
    (tmp_path / "vgg19.safetensors").rename(tmp_path / "vgg19-dcbb9e9d.pth")
    refused(cli, "verify", tmp_path / "vgg19-dcbb9e9d.pth", told=r"the published vgg19 dcbb9e9d…; get it again")
    refused(cli, "verify", tmp_path / "nowhere.pt", told=r"there is no file .*nowhere\.pt")


def test_incomplete_checkpoints_name_what_is_missing(cli: Cli, tmp_path: Path) -> None:
    state = small_checkpoint("full", "model.encoder.")
    for layer in (0, 1, 2):
        del state[f"model.encoder.aggregator_injection.frame_blocks.{layer}.norm1.weight"]
    torch.save({"state_dict": state}, tmp_path / "short.ckpt")
    refused(cli, "verify", tmp_path / "short.ckpt", told=r"3 missing \(aggregator_injection\.frame_blocks\.0\.norm1")


# Keeping the tensors alone


def test_conversion_drops_what_training_left_and_says_where_it_is_from(cli: Cli, tmp_path: Path) -> None:
    source, out = tmp_path / "last.ckpt", tmp_path / "head.safetensors"
    torch.save(training_checkpoint("head"), source)
    status, told, err = cli("convert", source, out)
    assert status == 0, err
    assert "a style branch of placement=head" in told
    assert out.stat().st_size < 0.6 * source.stat().st_size
    expected = small_checkpoint("head")
    converted = load_file(out)
    assert converted.keys() == expected.keys()
    assert all(torch.equal(converted[key], tensor) for key, tensor in expected.items())
    with safe_open(out, framework="pt") as file:
        metadata = file.metadata()
    assert metadata["layout"] == "anysplat"
    provenance = json.loads(metadata["provenance"])
    assert provenance["file"] == "last.ckpt" and len(provenance["sha256"]) == 64
    same(load_reference(out).state_dict(), load_reference(source).state_dict())


def same(one: dict[str, Tensor], other: dict[str, Tensor]) -> None:
    assert one.keys() == other.keys() and all(torch.equal(one[key], other[key]) for key in one)


def test_conversions_that_make_no_sense_are_refused(cli: Cli, tmp_path: Path) -> None:
    save_file(small_checkpoint(None), tmp_path / "it.safetensors")
    before = (tmp_path / "it.safetensors").read_bytes()
    refused(cli, "convert", tmp_path / "it.safetensors", tmp_path / "it.pt", told=r"end in \.safetensors")
    refused(cli, "convert", tmp_path / "it.safetensors", tmp_path / "it.safetensors", told="is the file that is read")
    refused(cli, "convert", "tiny_branch", tmp_path / "o.safetensors", told="nothing to convert")
    assert (tmp_path / "it.safetensors").read_bytes() == before


# Downloading


def test_what_no_hub_has_says_where_to_get_it(cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(weights.FOLDERS, str(tmp_path))
    refused(
        cli,
        "download",
        "anystyle_head",
        told=r"from https://zenodo\.org/records/18816747 .* put it as anystyle_head\.ckpt",
    )
    status, out, _ = cli("download", "tiny_branch")
    assert status == 0 and Path(out.strip()) == weights.find("tiny_branch")
