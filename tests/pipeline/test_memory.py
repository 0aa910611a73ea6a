"""What a pass takes, said before it is run."""

import subprocess
import sys

import numpy as np
import pytest
import torch

from anystyle.data.folder import read_views
from anystyle.data.images import open_image
from anystyle.evaluation.comparisons import Reader
from anystyle.evaluation.pairing import pair
from anystyle.io import limits, ply
from anystyle.io.video import read_frames, write_video
from anystyle.pipeline import encode, memory
from anystyle.pipeline.load import assemble
from anystyle.registry.compose import compose
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.training.run import train
from tests.support.pictures import save
from tests.support.refusals import raises_line
from tests.support.training_cases import RECONSTRUCTION, configuration


def test_the_peak_counts_what_lives_at_one_time():
    def function():
        first = torch.empty(1000)  # 4000 bytes
        second = first + 1
        del first
        return second * 2

    assert memory.peak(function) == 8000
    assert memory.peak(lambda: torch.empty(1000).view(10, 100)) == 4000


def test_encoding_grows_linearly_and_too_many_views_are_refused_before_anything_runs(monkeypatch):
    backbone = ToyBackbone()
    estimate = memory.encoding(backbone, (32, 32))
    assert estimate is not None and estimate[1] > 32 * 32 * 3 * 4
    needed = estimate[0] + 10 * estimate[1]
    monkeypatch.setattr(encode, "available", lambda device: int(needed / limits.USABLE) + 1)
    encode.require_encoding(backbone, 9, (32, 32), torch.device("cpu"))
    with pytest.raises(ValueError, match=r"12 views of 32x32: this takes .* set views.max_views=(9|10) "):
        encode.require_encoding(backbone, 12, (32, 32), torch.device("cpu"))
    looked = []
    monkeypatch.setattr(memory, "encoding", lambda *given: looked.append(given))
    monkeypatch.setattr(encode, "available", lambda device: 10 * 32 * 32 * encode.PLENTY)
    for views, times in ((9, 0), (10, 1)):
        encode.require_encoding(ToyBackbone(), views, (32, 32), torch.device("cpu"))
        assert len(looked) == times


@pytest.mark.parametrize("look", [lambda x: x.sum().item(), lambda x: x[x > 0], lambda x: x.numpy()])
def test_without_values_there_is_no_estimate_and_the_log_says_why(look, caplog, monkeypatch):
    backbone = ToyBackbone()
    monkeypatch.setattr(backbone.aggregator, "forward", lambda stem: look(stem.data))
    assert memory.encoding(backbone, (32, 32)) is None and "cannot run on tensors without values" in caplog.text
    encode.require_encoding(backbone, 10**6, (32, 32), torch.device("cpu"))


def test_what_a_limit_leaves_is_what_is_free():
    script = "import resource; from anystyle.io import limits; resource.setrlimit(resource.RLIMIT_AS, (1 << 30,) * 2); "
    done = subprocess.run([sys.executable, "-c", script + "print(limits.free())"], capture_output=True, text=True)
    assert 0 < int(done.stdout) < 1 << 30, done.stderr


def test_control_groups_limit_what_is_free(tmp_path):
    for name, content in (("max", "5000"), ("current", "4000"), ("stat", "anon 9\nfile 700\n")):
        (tmp_path / f"memory.{name}").write_text(content)
    assert limits._left_in_container(tmp_path) == [1700]
    (tmp_path / "memory.max").write_text("max")
    assert limits._left_in_container(tmp_path) == []


def photograph(folder, name="a", side=6000):
    return save(folder / f"{name}.png", np.zeros((side, side), np.uint8))


def read_photographs(folder):
    return read_views([photograph(folder, name, 2800) for name in "ab"], short_side=2800, multiple=14, max_views=2)


def read_video(folder):
    write_video([torch.zeros(3, 3072, 4096)] * 3, folder / "a.mp4", fps=1)
    return read_frames(folder / "a.mp4", 300_000)


def load_scene(folder):
    with (folder / "a.ply").open("wb") as file:
        file.truncate(1 << 30)
    return ply.read(folder / "a.ply")


def judge(folder):
    for name in ("content/1", "stylized/ink/1", "style/ink"):
        save(folder / f"{name}.png", np.zeros((4000, 4000), np.uint8))
    return Reader()(pair(folder / "content", folder / "style", folder / "stylized").cells[0])


SPENT = {
    "picture": (lambda folder: open_image(photograph(folder)), "6000 x 6000 pixels: this takes", "smaller"),
    "views": (read_photographs, "2 views of 2800x2800: this takes 0.4", "take fewer"),
    "video": (lambda folder: read_video(folder), "3 frames of 4096x3072 of .*a.mp4: this takes 0.1", "take fewer"),
    "splat": (load_scene, "a.ply: this takes 3.0 GiB", "fewer Gaussians"),
    "evaluation": (judge, "2 images of .* in ink, of up to 4000x4000: this takes 0.8", "fewer frames"),
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
    monkeypatch.setattr(limits, "free", lambda: 100_000_000)
    with raises_line(ValueError, match=rf"{needed}.*and 0\.1 GiB are free; .*{advice}"):
        work(tmp_path)
