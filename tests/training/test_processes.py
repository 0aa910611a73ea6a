"""Several processes are one, and a run that is killed is not lost: the weights at the end are the same."""

import os
import signal
import time
from pathlib import Path

import pytest
import torch
from safetensors.torch import load_file

from anystyle.training.run import train
from tests.support.fully_sharded import steps as steps_divided
from tests.support.processes import meeting, new, said, start, together
from tests.support.training_cases import STYLIZATION, configuration

TOY = (*(word for word in STYLIZATION if not word.startswith("trainer.max_steps=")), "export.half=false")


def finish(*processes) -> None:
    for process in processes:
        process.join()
        assert process.exitcode == 0


def branch(out: Path) -> dict[str, torch.Tensor]:
    return load_file(out / "branch.safetensors")


def steps(out: Path) -> int:
    """Those of the last checkpoint."""
    return torch.load(out / "last.ckpt", weights_only=True)["global_step"] if (out / "last.ckpt").is_file() else 0


def wait_for(out: Path, step: int, process) -> None:
    while steps(out) < step and process.is_alive():
        time.sleep(0.05)


def same(one, other, tolerance: float) -> None:
    assert one.keys() == other.keys()
    for key, tensor in one.items():
        torch.testing.assert_close(other[key], tensor, atol=tolerance, rtol=0)
        assert (other[key] - tensor).abs().mean() <= tolerance / 10, key


@pytest.mark.slow
def test_two_processes_that_are_killed_go_on_and_end_where_one_does(tmp_path):
    words = (*TOY, "styles.num_styles=6", "trainer.max_steps=20", "checkpoint.every_steps=4")
    words = (*words, "training.learning_rate=0.0001")  # Adam makes steps of what rounding leaves of tiny gradients
    out, both = tmp_path / "two", (*words, "trainer.strategy=ddp")
    processes = together(2, both, out)
    wait_for(out, 4, processes[0])
    for process in processes:
        process.kill()
        process.join()
    assert 4 <= steps(out) < 20
    finish(*together(2, both, out), *together(2, both, tmp_path / "whole"))
    same(branch(tmp_path / "whole"), branch(out), 0)
    train(configuration(words, tmp_path / "one"), tmp_path / "one")
    same(branch(tmp_path / "one"), branch(out), 1e-5)


@pytest.mark.slow
def test_two_processes_that_divide_the_branch_between_them_take_the_steps_of_one(tmp_path):
    words = (*TOY, "styles.num_styles=6", "trainer.max_steps=3")
    places = meeting(2)
    divided = [(words, tmp_path, rank, places, 2) for rank in range(2)]
    started = [new.Process(target=steps_divided, args=each) for each in (*divided, (words, tmp_path / "one"))]
    for process in started:
        process.start()
    finish(*started)
    one, *two = (torch.load(tmp_path / name, weights_only=True) for name in ("one/0.pt", "0.pt", "1.pt"))
    for each in two:
        same(one["weights"], each["weights"], 1e-5)
        assert one["held"] == 1 and each["held"] < 0.6


@pytest.mark.slow
@pytest.mark.parametrize("rank", [0, 1])
def test_a_signal_to_one_of_two_processes_ends_both_with_a_checkpoint_and_no_traceback(tmp_path, rank):
    out = tmp_path / "two"
    words = (*TOY, "styles.num_styles=6", "trainer.max_steps=400", "checkpoint.every_steps=4", "trainer.strategy=ddp")
    processes = together(2, words, out)
    wait_for(out, 4, processes[0])
    os.kill(processes[rank].pid, signal.SIGTERM)
    for process in processes:
        process.join(120)
    assert [process.exitcode for process in processes] == [0, 0]  # `train` returns; the command says 143
    assert 4 <= steps(out) < 400 and "Traceback" not in said(out)


@pytest.mark.slow
def test_a_full_disk_keeps_the_last_good_checkpoint_and_says_so_in_one_line(tmp_path):
    """A limit on the size of files stands for the disk: the operating system refuses to write what is beyond it."""
    words = (*TOY, "trainer.max_steps=4", "checkpoint.every_steps=2")
    finish(start((*words, "trainer.max_steps=2", "training.decay_steps=4"), tmp_path))
    good = (tmp_path / "last.ckpt").read_bytes()
    more = (*words, "training.decay_steps=4", "resume=changed")
    full = start(more, tmp_path, largest=len(good) // 2)
    full.join()
    assert full.exitcode == 2
    assert (tmp_path / "last.ckpt").read_bytes() == good and not list(tmp_path.glob(".partial-*"))
    told = [line for line in said(tmp_path).splitlines() if line.startswith("anystyle: error:")]
    assert len(told) == 1 and "Traceback" not in said(tmp_path)
    assert "the checkpoint of step 4 cannot be written" in told[0] and "the last one stays" in told[0], told
    finish(start(more, tmp_path), start((*words, "training.decay_steps=4"), tmp_path / "whole"))
    same(branch(tmp_path), branch(tmp_path / "whole"), 0)
