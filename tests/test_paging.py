"""Weights that give their pages back."""

import copy
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from anystyle.paging import brought, fill, give_back, thrifty

linux = pytest.mark.skipif(sys.platform != "linux", reason="pages are given back on Linux only")


@pytest.fixture
def mapped(tmp_path):
    """A layer of 16 MiB that reads its weights from a file."""
    generator = torch.Generator().manual_seed(0)
    save_file({"weight": torch.randn(2048, 2048, generator=generator)}, tmp_path / "layer.safetensors")
    with torch.device("meta"):
        layer = nn.Linear(2048, 2048, bias=False)
    layer.load_state_dict(load_file(tmp_path / "layer.safetensors"), assign=True)
    return layer.requires_grad_(False).eval()


def resident():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("RssFile"))


@linux
def test_pages_go_after_a_call_and_results_stay(mapped):
    x = torch.randn(1, 2048, generator=torch.Generator().manual_seed(1))
    expected = mapped(x)
    held = resident()
    assert thrifty([mapped]) > 15 * 2**20
    assert torch.equal(mapped(x), expected)
    assert held - resident() > 12 * 2**20
    assert torch.equal(mapped(x), expected)


@linux
def test_blocks_give_back_theirs_before_the_next_one_runs(tmp_path):
    tensors = {f"{place}.weight": torch.full((2048, 2048), 0.001) for place in range(4)}
    save_file(tensors, tmp_path / "blocks.safetensors")
    with torch.device("meta"):
        blocks = nn.ModuleList(nn.Linear(2048, 2048, bias=False) for _ in range(4))
    blocks.load_state_dict(load_file(tmp_path / "blocks.safetensors"), assign=True)
    part = nn.Module()
    part.blocks = blocks.requires_grad_(False)
    held = []

    def forward(x):
        for block in blocks:
            x = block(x)
            held.append(resident())
        return x

    part.forward = forward
    assert thrifty([part.eval()]) > 60 * 2**20
    before = resident()
    part(torch.ones(1, 2048))
    assert max(held) - before < 2**20


@linux
def test_what_was_written_into_is_never_dropped(mapped):
    thrifty([mapped])
    x = torch.ones(1, 2048)
    mapped.weight.zero_()
    assert mapped(x).abs().max() == 0
    assert mapped(x).abs().max() == 0


@linux
def test_what_was_written_past_autograd_is_never_dropped(mapped):
    """Through ``.data`` or NumPy nothing is counted; the kernel knows all the same."""
    thrifty([mapped])
    mapped.weight.data.numpy()[7] = 3.0
    x = torch.ones(1, 2048)
    for _ in range(2):
        assert mapped(x)[0, 7] == 3 * 2048


@linux
def test_a_tensor_brought_to_another_type_leaves_its_file(mapped):
    source = mapped.weight.data
    half = brought(source, torch.bfloat16)
    held = resident()
    expected = source.bfloat16()  # Looked at again: its pages are back.
    assert resident() - held > 14 * 2**20
    assert torch.equal(half, expected)
    give_back(source)
    assert resident() - held < 2**20
    assert torch.equal(source.bfloat16(), expected)
    assert brought(half, torch.bfloat16) is half


@linux
def test_a_module_is_filled_without_a_second_copy(mapped):
    source = mapped.weight.data
    own = nn.Linear(2048, 2048, bias=True).requires_grad_(False)
    bias, weight = own.bias.clone(), own.weight
    held = resident()
    fill(own, {"weight": source})
    assert resident() - held < 2**20
    assert own.weight is weight and torch.equal(own.weight, source) and torch.equal(own.bias, bias)
    with torch.device("meta"):
        empty = nn.Linear(2048, 2048, bias=False, dtype=torch.bfloat16)
    fill(empty, {"weight": source})
    assert torch.equal(empty.weight, source.bfloat16())


def test_giving_back_ones_own_memory_changes_nothing():
    own = torch.randn(512, 512)
    before = own.clone()
    give_back(own)
    give_back(own[:, ::2])
    assert torch.equal(own, before)


def test_memory_of_ones_own_is_left_alone():
    layer = nn.Linear(512, 512).requires_grad_(False).eval()
    before = layer.weight.clone()
    assert thrifty([layer]) == 0
    layer(torch.ones(1, 512))
    assert torch.equal(layer.weight, before)


@linux
def test_a_copy_keeps_its_weights(mapped):
    thrifty([mapped])
    other = copy.deepcopy(mapped)
    x = torch.ones(1, 2048)
    first = other(x)
    assert torch.equal(other(x), first)
    torch.testing.assert_close(mapped(x), first, atol=1e-3, rtol=1e-4)
