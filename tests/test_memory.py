"""What a pass takes, said before it is run."""

import io
import subprocess
import sys
import time
from functools import partial

import numpy as np
import psutil
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file, save_file

from anystyle import capacity
from anystyle.data.images import open_image, to_tensor
from anystyle.data.re10k import Re10kScenes
from anystyle.evaluation.folders import Reader, pair
from anystyle.inference import memory
from anystyle.inference.assemble import assemble
from anystyle.io import ply
from anystyle.io.video import read_frames, write_video
from anystyle.reconstructions.fit import Fit
from anystyle.registry.compose import compose
from anystyle.renderers.torch import TorchRenderer
from anystyle.testing.toy.backbone import ToyAggregator, ToyBackbone
from anystyle.training.run import train
from anystyle.types import untouched
from anystyle_tiny.procedural.scenes import ProceduralScenes
from training_cases import RECONSTRUCTION, configuration


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
    assert free is not None and 0 < free < 1 << 50
    assert memory.available(torch.device("meta")) is None


def test_what_a_limit_leaves_is_what_is_free():
    script = "import resource; from anystyle import capacity; resource.setrlimit(resource.RLIMIT_AS, (1 << 30,) * 2); "
    done = subprocess.run([sys.executable, "-c", script + "print(capacity.free())"], capture_output=True, text=True)
    assert 0 < int(done.stdout) < 1 << 30, done.stderr


@pytest.mark.parametrize(
    ("lines", "group", "files"),
    [
        ("0::/a/b\n", "a", {"memory.max": "5000", "memory.current": "4000", "memory.stat": "anon 9\nfile 700\n"}),
        ("0::/../elsewhere\n", "", {"memory.max": "5000", "memory.current": "4000", "memory.stat": "file 700\n"}),
        (
            "3:cpu,memory:/a/b\n",
            "memory/a/b",
            {"memory.limit_in_bytes": "5000", "memory.usage_in_bytes": "4000", "memory.stat": "total_cache 700\n"},
        ),
    ],
)
def test_control_groups_of_both_versions_limit_what_is_free(tmp_path, lines, group, files):
    (tmp_path / group).mkdir(parents=True, exist_ok=True)
    for name, content in files.items():
        (tmp_path / group / name).write_text(content)
    (tmp_path / "cgroup").write_text(lines)
    assert capacity._left_in_groups(tmp_path, tmp_path / "cgroup") == [1700]
    (tmp_path / group / "memory.max").write_text("max")
    assert capacity._left_in_groups(tmp_path, tmp_path / "cgroup") == ([1700] if "memory" in group else [])


def huge_clip(folder, short_side=None):
    """RealEstate10K with frames of 36 million pixels."""
    options = Re10kScenes.example(folder)
    chunk = torch.load(folder / "train" / "0.torch")
    buffer = io.BytesIO()
    Image.new("L", (6000, 6000)).save(buffer, "PNG")
    chunk[0]["images"] = [torch.frombuffer(bytearray(buffer.getvalue()), dtype=torch.uint8)] * 3
    torch.save(chunk, folder / "train" / "0.torch")
    return Re10kScenes(**options | ({} if short_side is None else {"short_side": short_side}))


def read_video(folder):
    write_video([torch.zeros(3, 3072, 4096)] * 3, folder / "a.mp4", fps=1)
    return read_frames(folder / "a.mp4", 300_000)


def load_scene(folder):
    with (folder / "a.ply").open("wb") as file:
        file.truncate(1 << 30)
    return ply.read(folder / "a.ply")


def judge(folder):
    for kind, name in (("content", "1"), ("stylized", "ink_1"), ("style", "ink")):
        (folder / kind).mkdir()
        Image.new("L", (4000, 4000)).save(folder / kind / f"{name}.png")
    paired = pair(folder / "content", folder / "style", folder / "stylized")
    return Reader()(paired.cells[0])


def fit(folder):
    views = ProceduralScenes(size=28).read(0, range(2))
    return Fit(num_gaussians=2_000_000)(views, lambda views: pytest.fail("encoded"), TorchRenderer())


SPENT = {
    "picture": (lambda folder: huge_clip(folder).read(0, [0]), "6000 x 6000 pixels: this takes", "smaller"),
    "views": (lambda folder: huge_clip(folder, 2800).read(0, [0, 1]), "2 views of 2800x2800: this takes 0.4", "take"),
    "video": (lambda folder: read_video(folder), "3 frames of 4096x3072 of .*a.mp4: this takes 0.1", "take fewer"),
    "splat": (load_scene, "a.ply: this takes 3.0 GiB", "fewer Gaussians"),
    "evaluation": (judge, "2 images of .* in ink, of up to 4000x4000: this takes 0.8", "fewer frames"),
    "fit": (fit, "2,000,000 Gaussians: this takes 0.4 GiB", "reconstruction.num_gaussians"),
    "model": (
        lambda folder: assemble(compose("stylize", ["~model"])),
        "the weights of the backbone: this takes 4.4 GiB",
        "model=NAME",
    ),
    "learning": (
        lambda folder: train(configuration([*RECONSTRUCTION, "backbone.dim=512"], folder), folder),
        "the weights of the backbone, with what learning adds: this takes",
        "model=NAME",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", SPENT)
def test_what_memory_does_not_hold_is_refused_before_it_is_spent(tmp_path, monkeypatch, what):
    work, needed, advice = SPENT[what]
    monkeypatch.setattr(capacity, "free", lambda: 100_000_000)
    with pytest.raises(ValueError, match=rf"{needed}.*and 0\.1 GiB are free; .*{advice}") as caught:
        work(tmp_path)
    assert "\n" not in str(caught.value)


def test_huge_pictures_are_reduced_while_they_are_read(tmp_path):
    """Of 16 bits and of palettes, too, and to what they are: their means."""
    ramp = np.linspace(0, 255, 4000).round()
    Image.fromarray((np.broadcast_to(ramp, (4000, 4000)) * 257).astype(np.uint16)).save(tmp_path / "levels.png")
    Image.fromarray(np.broadcast_to(ramp, (4000, 4000)).astype(np.uint8)).convert("P").save(tmp_path / "palette.png")
    expected = torch.from_numpy(ramp / 255).float().unflatten(0, (100, 40)).mean(1)
    for name in ("levels.png", "palette.png"):
        before = psutil.Process().memory_info().rss
        peak = memory.sampled_peak(partial(open_image, tmp_path / name, longest=100))
        assert peak - before < 9 * 4000 * 4000
        picture = to_tensor(open_image(tmp_path / name, longest=100))
        assert picture.shape == (3, 100, 100)
        torch.testing.assert_close(picture, expected.expand(3, 100, 100), atol=2 / 255, rtol=0)


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
