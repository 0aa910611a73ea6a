"""`anystyle train`, as people call it."""

import csv
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import yaml

from anystyle.cli.launch import launch, main
from anystyle.cli.run import run as ending
from anystyle.commands.train import run
from anystyle.errors import UserError
from anystyle.io.run_folder import changes
from anystyle.registry.compose import compose
from anystyle.training.resume import bound
from anystyle.training.safeguards import FiniteLoss
from anystyle.training.stylization import StylizationTraining
from anystyle.training.trainer import make_trainer
from tests.support.training_cases import BACKBONE, STYLIZATION, configuration


def test_a_smoke_run_learns_and_says_what_it_left(tmp_path):
    small = [word for word in BACKBONE if not word.startswith(("backbone=", "renderer="))]
    words = [
        "train", "experiment=tiny_reconstruction", "debug=smoke", *small, "scenes.num_scenes=2", "training.warmup=2",
        "training.learning_rate=0.003", "training.render_every=1", "trainer.precision=32-true",
        "trainer.profiler=simple",
    ]  # fmt: skip
    # A process of its own: Lightning's logger keeps the error stream that it was imported with.
    done = subprocess.run([sys.executable, "-m", "anystyle", *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == "12 steps done; backbone.safetensors in runs/smoke-tiny_reconstruction\n"
    assert "Traceback" not in done.stderr and "Warning" not in done.stderr
    with (tmp_path / "runs/smoke-tiny_reconstruction/log/version_0/metrics.csv").open() as file:
        losses = [float(row["train/loss"]) for row in csv.DictReader(file) if row["train/loss"]]
    assert sum(losses[-4:]) < 0.95 * sum(losses[:4])
    progress, _, report = done.stderr.partition("FIT Profiler Report")
    assert progress.splitlines()[-1].startswith("val/") and "run_training_batch" in report


def refused(capsys, *words: str) -> str:
    """What a command line that ends with status 2 says in its one line, below those of a sweep of two jobs.

    In this process, which has imported everything.
    """
    with pytest.raises(SystemExit) as ended:
        ending(lambda: launch("train", run, words))
    told = capsys.readouterr()
    assert ended.value.code == 2 and told.out == "" and told.err.count("\n") == 1 + 5 * ("-m" in words)
    return told.err


def test_mistakes_end_in_one_line(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert "max_stepps" in refused(capsys, "experiment=tiny_reconstruction", "debug=smoke", "trainer.max_stepps=3")
    assert not list(tmp_path.iterdir())
    assert "trainer.max_steps=0: " in refused(capsys, *STYLIZATION, "trainer.max_steps=0")


def test_an_agent_of_a_wandb_sweep_gives_overrides_as_flags_and_a_search_path_keeps_the_plugins(tmp_path, monkeypatch):
    (tmp_path / "conf" / "experiment").mkdir(parents=True)
    (tmp_path / "conf" / "experiment" / "mine.yaml").write_text(
        "# @package _global_\ndefaults: [tiny_ablation, _self_]\nvalidation_steps: 3\n"
    )
    monkeypatch.chdir(tmp_path)
    words = ["--training.learning_rate=1e-5", "--seed=3", "experiment=mine", "hydra.searchpath=[file://conf]"]
    monkeypatch.setattr(sys, "argv", ["train", *words])
    seen = []
    main("train", seen.append)
    assert [(each.training.learning_rate, each.seed, each.validation_steps) for each in seen] == [(1e-5, 3, 3)]


@pytest.mark.parametrize(("word", "kept"), [("loss=[content]", {"content"}), ("without=[content,style]", None)])
def test_the_configuration_that_is_shown_has_the_losses_that_take_part(tmp_path, monkeypatch, capsys, word, kept):
    (tmp_path / "experiment").mkdir()
    (tmp_path / "experiment" / "mine.yaml").write_text("# @package _global_\ndefaults: [tiny_ablation]\n")
    monkeypatch.setattr(
        sys, "argv", ["train", "experiment=mine", "-cd", str(tmp_path), word, "--cfg=job", "-p", "loss"]
    )
    main("train", lambda config: None)
    shown = set(yaml.safe_load(capsys.readouterr().out))
    assert shown == kept or (not kept and {"clip_patch"} <= shown and not shown & {"content", "style", "teacher"})


def test_a_working_folder_of_the_jobs_own_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    told = refused(capsys, *STYLIZATION, "hydra.job.chdir=true")
    assert "hydra.job.chdir=true: relative paths" in told and not list(tmp_path.iterdir())


@pytest.mark.parametrize("word", ["styles=null", "scenes@validation_scenes=null", "loss=null", "callbacks=null"])
def test_a_group_that_is_set_to_null_is_told_with_the_way_out(word):
    way = f"{word[:-5]}=[]" if word.startswith(("loss", "callbacks")) else f"~{word[:-5]}"
    with pytest.raises(UserError, match=re.escape(f"{word}: a group takes a name; to leave it out, write '{way}'")):
        compose("train", ["experiment=paper_head", word, "name=x", "out=y"])
    if "[]" in way:
        compose("train", ["experiment=paper_head", way, "name=x", "out=y"])
    assert compose("train", ["experiment=paper_head", "~model", "name=x", "out=y"]).weights.backbone is None


def test_devices_inside_a_multirun_are_refused_with_a_way_out(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    told = refused(capsys, "-m", "trainer.devices=2", "seed=0,1", "training=reconstruction", "loss=[]")
    assert "trainer.devices=2 inside a multirun" in told and "submitit_slurm" in told


def test_processes_that_a_training_starts_show_no_traceback_that_nobody_asked_for(monkeypatch, capsys):
    for name in ("ANYSTYLE_TRACEBACK", "HYDRA_FULL_ERROR"):
        monkeypatch.delenv(name, raising=False)
    inherited = []
    launch("train", lambda config: inherited.append(dict(os.environ)), [*STYLIZATION])
    monkeypatch.setattr(os, "environ", inherited[0])

    def mistaken() -> None:
        raise UserError("3 scenes cannot be shared by 2 processes")

    with pytest.raises(SystemExit):
        ending(mistaken)
    assert capsys.readouterr().err == "anystyle: error: 3 scenes cannot be shared by 2 processes\n"


def test_a_recipe_starts_twice_and_leaves_no_folder_of_a_sweep(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    started = []
    for pause in (0, 1.1):
        time.sleep(pause)  # a folder named after the time would have another name
        launch(
            "train",
            lambda config: started.append((bound(config), config.cache)),
            ["experiment=tiny_ablation", "name=one"],
        )
    assert started[0] == started[1] and Path(started[0][1]) == tmp_path / "runs/one/scenes"
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


def test_where_files_lie_is_not_compared_and_one_folder_is_the_same_by_each_of_its_names(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "link").symlink_to("data")
    words = [*STYLIZATION, "scenes=folder", "out=x"]
    words = [
        word for word in words if word.partition("=")[0] not in ("scenes.size", "scenes.num_scenes", "scenes.samples")
    ]
    before, *same = (
        bound(compose("train", [*words, f"scenes.root={root}", f"cache={cache}"]))
        for cache, root in [("null", "data"), ("a", tmp_path / "data"), ("b", "./data/"), ("c", "link")]
    )
    assert [changes(before, now) for now in same] == ["", "", ""]
    assert changes(before, bound(compose("train", [*words, "scenes.root=other"]))) == "scenes.root data -> other"


def test_arguments_of_the_trainer_need_no_plus(tmp_path):
    words = ["accumulate_grad_batches=2", "max_time='00:01:00:00'", "gradient_clip_algorithm=value"]
    config = configuration([*STYLIZATION, *(f"trainer.{word}" for word in words)], tmp_path)
    trainer = make_trainer(config, tmp_path, FiniteLoss(tmp_path / "refused_batch.pt"), [])
    assert trainer.accumulate_grad_batches == 2 and trainer.gradient_clip_algorithm == "value"


@pytest.mark.slow
def test_a_signal_ends_a_sweep_after_saving_and_the_next_start_goes_on(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    words = ["-m", *STYLIZATION, "trainer.max_steps=3", "seed=0,1", "hydra.sweep.dir=sweep"]
    whole, steps = StylizationTraining.training_step, []

    def training_step(self, batch, index):
        steps.append(index)
        if len(steps) == 2:
            signal.raise_signal(signal.SIGTERM)
        return whole(self, batch, index)

    monkeypatch.setattr(StylizationTraining, "training_step", training_step)
    with pytest.raises(KeyboardInterrupt):
        launch("train", run, words)
    assert "stopped after step 2" in capsys.readouterr().out and steps == [0, 1]
    assert (tmp_path / "sweep/0/last.ckpt").is_file() and not (tmp_path / "sweep/1").exists()
    launch("train", run, words)
    assert steps == [0, 1, 2, 0, 1, 2]
    assert capsys.readouterr().err.count("resuming from step 2 of 3\n") == 1
    assert all((tmp_path / "sweep" / job / "branch.safetensors").is_file() for job in "01")
