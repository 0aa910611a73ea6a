"""Weights that give their pages back."""

import copy
import sys
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file, save_file
from torch import nn

from anystyle.paging import thrifty

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
def test_what_was_written_into_is_never_dropped(mapped):
    thrifty([mapped])
    x = torch.ones(1, 2048)
    mapped.weight.zero_()
    assert mapped(x).abs().max() == 0
    assert mapped(x).abs().max() == 0


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
