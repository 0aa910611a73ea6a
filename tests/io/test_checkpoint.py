import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from torch import nn

from anystyle.io.checkpoint import FORMAT, SCALES, Header, dequantized, load_part, load_strictly, read_header, save_part
from anystyle.vision import weights
from tests.support import quantize


def network(width=4):
    torch.manual_seed(width)
    return nn.Sequential(nn.Linear(3, width), nn.BatchNorm1d(width))


def test_what_is_saved_is_loaded_bit_for_bit_with_what_it_says_of_itself(tmp_path):
    header = Header("branch", {"a": [1, 2]}, {"backbone": "00"}, {"command": "anystyle train", "seed": 3})
    save_part(tmp_path / "a.safetensors", network(), header)
    other = network()
    nn.init.zeros_(other[0].weight)
    assert load_part(tmp_path / "a.safetensors", other, "branch") == header
    for key, tensor in network().state_dict().items():
        assert torch.equal(other.state_dict()[key], tensor), key
    assert read_header(tmp_path / "a.safetensors") == header


def test_what_a_header_omits_stays_as_the_module_has_it(tmp_path):
    save_part(tmp_path / "a.safetensors", network(), Header("branch", omitted=("1",)))
    with safe_open(tmp_path / "a.safetensors", "pt") as file:
        assert set(file.keys()) == {"0.weight", "0.bias"}
    other = network()
    nn.init.zeros_(other[0].weight)
    nn.init.constant_(other[1].weight, 7.0)
    assert load_part(tmp_path / "a.safetensors", other, "branch").omitted == ("1",)
    assert torch.equal(other[0].weight, network()[0].weight) and bool((other[1].weight == 7).all())
    save_part(tmp_path / "less.safetensors", network()[:1], Header("branch"))
    with pytest.raises(ValueError, match="5 missing"):
        load_part(tmp_path / "less.safetensors", other, "branch")


def test_half_precision_halves_the_file_and_keeps_integers(tmp_path):
    save_part(tmp_path / "half.safetensors", network(), Header("branch"), half=True)
    with safe_open(tmp_path / "half.safetensors", "pt") as file:
        kinds = {key: file.get_tensor(key).dtype for key in file.keys()}  # noqa: SIM118
    assert kinds["0.weight"] == torch.float16 and kinds["1.num_batches_tracked"] == torch.int64
    other = network()
    load_part(tmp_path / "half.safetensors", other, "branch")
    assert other[0].weight.dtype == torch.float32
    torch.testing.assert_close(other[0].weight, network()[0].weight, rtol=1e-3, atol=1e-4)


def test_eight_bits_are_half_a_step_from_what_they_store(tmp_path, monkeypatch):
    monkeypatch.setattr(quantize, "SMALL", 0)
    stored, packed = network(200), tmp_path / "packed.safetensors"
    save_part(tmp_path / "half.safetensors", stored, Header("branch"), half=True)
    quantize.main(str(tmp_path / "half.safetensors"), str(packed))
    other = network(200)
    nn.init.zeros_(other[0].weight)
    assert load_part(packed, other, "branch") == Header("branch")
    error, step = (other[0].weight - stored[0].weight).detach().abs(), stored[0].weight.detach().abs().amax(1) / 127
    assert 0 < error.mean() < 0.3 * step.mean() and bool((error.square().sum(1) < step.square()).all())
    assert torch.equal(other[0].bias, stored[0].bias.half())
    assert torch.equal(weights.read(packed)["0.weight"], other[0].weight)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"a" + SCALES: None}, "a is in 8 bits and needs a:scales, one number for each of its rows"),
        ({"a" + SCALES: torch.ones(3)}, "a is in 8 bits and needs a:scales"),
        ({"b" + SCALES: torch.ones(2)}, "b:scales belongs to no tensor in 8 bits"),
    ],
)
def test_eight_bits_come_with_a_scale_for_each_row(change, said):
    stored = {"a": torch.ones(2, 4, dtype=torch.int8), "a" + SCALES: torch.ones(2), "b": torch.ones(2)} | change
    with pytest.raises(ValueError, match=f"^FILE: {said}"):
        dequantized({key: tensor for key, tensor in stored.items() if tensor is not None}, source="FILE")


def test_differences_are_named_up_to_five_of_a_kind():
    state = network().state_dict()
    state["0.weight"] = torch.zeros(9, 9)
    del state["0.bias"]
    state["1.running_mean"] = state["1.running_mean"].long()
    state |= {f"extra.{place}": torch.zeros(1) for place in range(7)}
    before = {key: tensor.clone() for key, tensor in network().state_dict().items()}
    target = network()
    with pytest.raises(ValueError, match="does not fit this Sequential") as caught:
        load_strictly(target, state, source="file.safetensors")
    message = str(caught.value)
    assert "1 missing (0.bias)" in message and "0.weight is [9, 9], not [4, 3]" in message
    assert "1 integer (1.running_mean)" in message
    assert "7 unexpected (extra.0, extra.1, extra.2, extra.3, extra.4, …)" in message
    assert all(torch.equal(tensor, before[key]) for key, tensor in target.state_dict().items())


def test_files_that_are_not_ours_are_refused(tmp_path):
    save_part(tmp_path / "whole.safetensors", network(), Header("backbone"))
    data = (tmp_path / "whole.safetensors").read_bytes()
    (tmp_path / "half.safetensors").write_bytes(data[: len(data) // 2])
    save_file({"a": torch.zeros(1)}, tmp_path / "plain.safetensors")
    told = {"half": "not a valid safetensors file; get it again", "plain": "not a safetensors file that anystyle wrote"}
    told |= {"absent": "there is no weights file", "whole": "weights of a backbone, but those of a branch"}
    for name, words in told.items():
        with pytest.raises(ValueError, match=words):
            load_part(tmp_path / f"{name}.safetensors", network(), "branch")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("config", '{"backbone": {"depth": "${oc.env:SECRET}"}}', "holds an interpolation"),
        ("config", "{", "config in the header of .* is not a valid JSON"),
        ("base", "null", "is not a valid header of weights .* at 'base'"),
        ("omitted", "3", "is not a valid header of weights .* at 'omitted'"),
    ],
)
def test_a_header_of_another_form_is_one_line(tmp_path, monkeypatch, name, value, message):
    monkeypatch.setenv("SECRET", "whispered")
    plain = {"format": FORMAT, "part": "branch", "config": "{}", "base": "{}", "provenance": "{}"}
    save_file({"weight": torch.zeros(1)}, tmp_path / "whole.safetensors", plain)
    assert read_header(tmp_path / "whole.safetensors").part == "branch"
    save_file({"weight": torch.zeros(1)}, tmp_path / "a.safetensors", plain | {name: value})
    with pytest.raises(ValueError, match=message) as caught:
        read_header(tmp_path / "a.safetensors")
    said = str(caught.value)
    assert "a.safetensors" in said and "whispered" not in said and "\n" not in said
