"""What a pass takes, said before it is run."""

import subprocess
import sys
import time

import pytest
import torch
from safetensors.torch import load_file, save_file

from anystyle.inference import memory
from anystyle.testing.toy.backbone import ToyAggregator, ToyBackbone
from anystyle.types import untouched


def test_the_peak_counts_what_lives_at_one_time():
    def function():
        first = torch.empty(1000)  # 4000 bytes
        second = first + 1
        del first
        return second * 2

    assert memory.peak(function) == 8000
    assert memory.peak(lambda: torch.empty(1000).view(10, 100)) == 4000


def test_encoding_grows_linearly_and_says_what_fits():
    estimate = memory.encoding(ToyBackbone(), (32, 32))
    assert estimate is not None and estimate.slope > 32 * 32 * 3 * 4
    assert estimate(20) > estimate(10)
    fits = estimate.fits(estimate(50) + 1)
    assert fits in (49, 50) and estimate.fits(0) == 0


def test_too_many_views_are_refused_before_anything_runs(monkeypatch):
    backbone = ToyBackbone()
    estimate = memory.encoding(backbone, (32, 32))
    assert estimate is not None
    monkeypatch.setattr(memory, "available", lambda device: int(estimate(10) / memory.USABLE) + 1)
    memory.check(backbone, 9, (32, 32), torch.device("cpu"))
    with pytest.raises(ValueError, match=r"12 views of 32x32 need .* set views.max_views=(9|10) "):
        memory.check(backbone, 12, (32, 32), torch.device("cpu"))


def test_where_even_plenty_is_free_nothing_is_estimated(monkeypatch):
    looked = []
    monkeypatch.setattr(memory, "encoding", lambda *given: looked.append(given))
    monkeypatch.setattr(memory, "available", lambda device: 10 * 32 * 32 * memory.PLENTY)
    for views, times in ((9, 0), (10, 1)):
        memory.check(ToyBackbone(), views, (32, 32), torch.device("cpu"))
        assert len(looked) == times


class Curious(ToyAggregator):
    """An aggregator that looks at values, in one way or another, or is broken."""

    def __init__(self, look):
        super().__init__(dim=12, depth=2)
        self.look = look

    def forward(self, stem, inject=untouched):
        self.look(stem.data)
        return super().forward(stem, inject)


@pytest.mark.parametrize("look", [lambda x: x.sum().item(), lambda x: x[x > 0], lambda x: x.numpy()])
def test_without_values_there_is_no_estimate_and_the_log_says_why(look, caplog):
    backbone = ToyBackbone(dim=12)
    backbone.aggregator = Curious(look)
    assert memory.encoding(backbone, (32, 32)) is None
    assert "the backbone asks for values" in caplog.text
    memory.check(backbone, 10**6, (32, 32), torch.device("cpu"))


@pytest.mark.parametrize("error", [RuntimeError("the rope is torn"), ValueError("views of 32x32 are too small")])
def test_what_is_broken_is_not_taken_for_unknown(error):
    def look(_):
        raise error

    backbone = ToyBackbone(dim=12)
    backbone.aggregator = Curious(look)
    with pytest.raises(type(error), match=str(error)):
        memory.encoding(backbone, (32, 32))


def test_free_memory_is_known_here():
    free = memory.available(torch.device("cpu"))
    assert free is None or free > 0


def test_the_sampled_peak_is_of_the_processs_own_memory():
    """In a process of its own: one that freed memory before takes new blocks from that."""
    script = """
import time
import torch
from anystyle.inference import memory

def block():
    held = torch.ones(64 * 2**20, dtype=torch.uint8)
    time.sleep(0.1)
    return held

before = memory.sampled_peak(lambda: None)
print(memory.sampled_peak(block) - before)
"""
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert int(run.stdout) > 48 * 2**20


@pytest.mark.skipif(sys.platform != "linux", reason="memory of files is told apart on Linux")
def test_pages_of_a_file_are_not_the_processs_own(tmp_path):
    save_file({"a": torch.ones(64 * 2**20, dtype=torch.uint8)}, tmp_path / "a.safetensors")
    before = memory.sampled_peak(lambda: None)

    def mapped():
        tensor = load_file(tmp_path / "a.safetensors")["a"]
        assert int(tensor.max()) == 1
        time.sleep(0.1)

    assert memory.sampled_peak(mapped) - before < 16 * 2**20
