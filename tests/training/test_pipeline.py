"""Pipelines of trainings: each finds what earlier ones exported, and a stopped pipeline goes on."""

import os
import signal
import sys
import threading
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from anystyle.registry.compose import compose
from anystyle.training import pipeline
from anystyle.training.pipeline import WEIGHTS, train_pipeline

PIPELINE = {"first": {"backbone": "tiny_backbone"}, "second": {"branch": "tiny_branch"}}


def test_each_training_finds_the_weights_made_before_it(tmp_path: Path) -> None:
    seen: list[tuple[list[str], list[str]]] = []

    def launch(words: Sequence[str], environment: Mapping[str, str]) -> int:
        folder = Path(environment["ANYSTYLE_WEIGHTS"].split(os.pathsep)[0])
        seen.append(([*words], sorted(path.name for path in folder.iterdir())))
        experiment = words[0].removeprefix("experiment=")
        run = tmp_path / experiment
        run.mkdir(exist_ok=True)
        part = {"first": "backbone", "second": "branch"}[experiment]
        (run / f"{part}.safetensors").write_bytes(experiment.encode())
        return 0

    made = train_pipeline(PIPELINE, ["experiment=tiny_all", "+name=x", "out=there", "seed=3"], tmp_path, launch=launch)
    assert [path.name for path in made] == ["tiny_backbone.safetensors", "tiny_branch.safetensors"]
    assert made[1].read_bytes() == b"second" and made[0].parent == tmp_path / WEIGHTS
    assert [words[0] for words, _ in seen] == ["experiment=first", "experiment=second"]
    # Its own words are not passed on.
    assert all(words[3:] == ["seed=3"] for words, _ in seen)
    assert [known for _, known in seen] == [[], ["tiny_backbone.safetensors"]]


def test_a_training_that_fails_or_leaves_nothing_stops_the_pipeline(tmp_path: Path) -> None:
    for status in (2, 0):
        with pytest.raises(ValueError, match="experiment=first; the same command resumes there"):
            train_pipeline(PIPELINE, [], tmp_path, launch=lambda words, environment, status=status: status)
    assert not list((tmp_path / WEIGHTS).iterdir())


def test_the_recipe_names_experiments_and_weights_that_there_are(tmp_path: Path) -> None:
    pipeline = compose("train", ["experiment=tiny_all", "name=x", "out=y"]).pipeline
    assert [*pipeline] == ["tiny_perceptual", "tiny_embedding", "tiny_reconstruction", "tiny_style"]
    for experiment in pipeline:
        compose("train", [f"experiment={experiment}", "name=x", "out=y"])
    with pytest.raises(ValueError, match="give one part and the name of its weights"):
        train_pipeline({"tiny_style": {"branch": "nothing"}}, [], tmp_path)


def test_a_signal_reaches_the_training_which_saves_before_the_pipeline_ends(tmp_path: Path, monkeypatch) -> None:
    script = tmp_path / "training"
    script.write_text(
        f"#!{sys.executable}\n"
        "import pathlib, signal, sys, time\n"
        f"here = pathlib.Path({str(tmp_path)!r})\n"
        "signal.signal(signal.SIGTERM, lambda *_: ((here / 'saved').touch(), sys.exit(0)))\n"
        "(here / 'ready').touch()\n"
        "time.sleep(60)\n"
    )
    script.chmod(0o700)
    monkeypatch.setattr(pipeline.sys, "executable", str(script))

    def stop() -> None:
        while not (tmp_path / "ready").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGTERM)

    before = signal.getsignal(signal.SIGTERM)
    threading.Thread(target=stop, daemon=True).start()
    with pytest.raises(ValueError, match="stopped in experiment=first; the same command resumes"):
        train_pipeline(PIPELINE, [], tmp_path / "out")
    assert (tmp_path / "saved").exists() and signal.getsignal(signal.SIGTERM) is before
