"""The jobs of a sweep: how each is announced, and the command that repeats it."""

import shlex

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException

from anystyle.cli.launch import launch
from anystyle.registry.jobs import command_line, values_of

WORDS = ["training=reconstruction", "loss=[]", "weights.backbone=a/b.safetensors"]


def jobs(words: list[str], capsys) -> tuple[list[list[str]], list[str]]:
    """The words of each job's command, and the lines that announce them."""
    commands: list[str] = []
    launch("train", lambda config: commands.append(command_line("train")), words)
    return [shlex.split(command) for command in commands], capsys.readouterr().err.splitlines()


def test_each_job_says_what_it_is_and_records_its_own_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    varied = ["seed=1,2", "without=[style],[content,style]", "training.context_views=[2,3]"]
    commands, told = jobs(["-m", *WORDS, *varied, "hydra.sweep.dir=sweep"], capsys)
    assert told == [
        f"job {number} of 4: seed={seed} without={without}"
        for number, (seed, without) in enumerate(
            [(1, "[style]"), (1, "[content,style]"), (2, "[style]"), (2, "[content,style]")], 1
        )
    ]
    assert commands[3] == ["anystyle", "train", *WORDS, "seed=2", "without=[content,style]", varied[2]]
    # By itself the command of a job makes the job again, and is its own record.
    again, told = jobs(commands[3][2:], capsys)
    assert again == [commands[3]] and told == []


@pytest.mark.parametrize("flag", ["hydra.run.dir=there", "--config-dir=own"])
def test_what_decides_on_files_and_configurations_is_part_of_the_command(flag, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "own").mkdir()
    ((*_, last),), _ = jobs([*WORDS, flag], capsys)
    assert last == flag.replace("own", str(tmp_path / "own"))
    assert command_line("train") == ""  # nothing is running


def test_the_jobs_of_a_multirun_are_every_combination_and_of_one_key_the_last_values_count():
    parser = OverridesParser.create()
    words = ["seed=0,1", "placement=head,full", "seed=2,3", "~model", "trainer.max_steps=range(1,3)"]
    values = [["seed=2", "seed=3"], ["placement=head", "placement=full"], ["~model"]]
    assert values_of(words, parser) == [*values, ["trainer.max_steps=1", "trainer.max_steps=2"]]
    with pytest.raises(HydraException, match="INTERVAL"):
        values_of(["weight=interval(0,1)"], parser)
