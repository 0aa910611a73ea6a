"""Several processes are one, and a run that is killed is not lost: the weights at the end are the same."""

import random
import time

import pytest
import torch
from safetensors.torch import load_file

from anystyle.training.run import train
from training_cases import STYLIZATION, configuration
from training_processes import start, together

TOY = (*(word for word in STYLIZATION if not word.startswith("trainer.max_steps=")), "export.half=false")


def finish(*processes) -> None:
    for process in processes:
        process.join(120)
        assert process.exitcode == 0


@pytest.mark.parametrize("strategy", ["ddp", "fsdp2"])
def test_two_processes_end_where_one_does(tmp_path, strategy):
    words = (*TOY, "styles.num_styles=6", "trainer.max_steps=20")
    finish(*together(2, (*words, f"trainer.strategy={strategy}"), tmp_path / "two"))
    train(configuration(words, tmp_path / "one"), tmp_path / "one")
    one, two = (load_file(tmp_path / name / "branch.safetensors") for name in ("one", "two"))
    assert one.keys() == two.keys()
    for key, tensor in one.items():
        torch.testing.assert_close(two[key], tensor, atol=1e-5, rtol=0)


@pytest.mark.slow
def test_a_sharded_run_continues_and_its_checkpoint_is_every_others(tmp_path):
    words = (*TOY, "placement=full", "styles.num_styles=6", "training.decay_steps=6")
    half, end = (*words, "trainer.max_steps=3"), (*words, "trainer.max_steps=6", "resume=changed")
    finish(*together(2, (*half, "trainer.strategy=fsdp2"), tmp_path / "two"))
    finish(*together(2, (*end, "trainer.strategy=fsdp2"), tmp_path / "two"))
    train(configuration(half, tmp_path / "one"), tmp_path / "one")
    ours, theirs = (torch.load(tmp_path / name / "last.ckpt", weights_only=True) for name in ("one", "two"))
    assert ours["state_dict"].keys() == theirs["state_dict"].keys()
    assert ours["optimizer_states"][0]["state"].keys() == theirs["optimizer_states"][0]["state"].keys()
    train(configuration(end, tmp_path / "one"), tmp_path / "one")
    one, two = (load_file(tmp_path / name / "branch.safetensors") for name in ("one", "two"))
    for key, tensor in one.items():
        torch.testing.assert_close(two[key], tensor, atol=2e-5, rtol=0)


@pytest.mark.slow
def test_killed_at_ten_random_moments_a_run_ends_with_the_same_weights(tmp_path):
    words = (*TOY, "trainer.max_steps=60", "checkpoint.every_steps=1", "average=0.9", "styles.num_styles=6")
    began = time.monotonic()
    finish(start(words, tmp_path / "whole"))
    whole = time.monotonic() - began
    chance = random.Random(0)
    kills = 0
    while kills < 10:
        process = start(words, tmp_path / "killed")
        # A tenth of a run at most, for the later half of the kills must still find it at work.
        time.sleep(chance.uniform(0.2, 1.0) * whole / 4)
        process.kill()
        process.join()
        kills += process.exitcode != 0
        if process.exitcode == 0:
            break
    steps = torch.load(tmp_path / "killed" / "last.ckpt", weights_only=True)["global_step"]
    assert kills == 10, f"the run was over after {kills} kills, at step {steps}"
    finish(start(words, tmp_path / "killed"))
    one, two = (load_file(tmp_path / name / "branch.safetensors") for name in ("whole", "killed"))
    assert all(torch.equal(one[key], two[key]) for key in one)
    assert not list((tmp_path / "killed").glob(".last-*"))
