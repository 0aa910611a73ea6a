"""One sweep, started more than once: jobs are shared, and what is finished stays as it is."""

from pathlib import Path

import pytest

from anystyle.cli.launch import launch
from anystyle.commands import train as command
from anystyle.io import atomic
from tests.io.test_lock import LEASE, holder
from tests.support.toy_sweep import sweep_words, write_plugin

WORDS = ["-m", *sweep_words("sweep", seeds="0")]


def state(folder: Path) -> dict[str, tuple[int, int]]:
    """Every file and folder with its inode and time."""
    return {str(path): (path.stat().st_ino, path.stat().st_mtime_ns) for path in [folder, *folder.rglob("*")]}


def test_a_job_of_another_machine_is_left_to_it_and_taken_over_when_that_has_gone(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(atomic, "LEASE", LEASE)
    for name, value in write_plugin(tmp_path / "plugin", LEASE).items():
        monkeypatch.setenv(name, value)
    order, whole = [], command.train
    with holder(tmp_path / "sweep" / "0", "elsewhere") as process:

        def train(config, out, on_begin):
            order.append(out.name)
            if out.name == "3":
                process.kill()
            return whole(config, out, on_begin)

        monkeypatch.setattr(command, "train", train)
        launch("train", command.run, WORDS)
    told = capsys.readouterr().err
    assert order == ["0", "1", "2", "3", "0"]
    assert f"process {process.pid} on elsewhere is at work in sweep/0; left to it\n" in told
    assert f"waiting for sweep/0, where process {process.pid} on elsewhere is at work\n" in told
    assert "Error" not in told and len(list(tmp_path.glob("sweep/*/backbone.safetensors"))) == 4

    before = state(tmp_path)
    monkeypatch.setattr("anystyle.training.run.exclusive", lambda out: pytest.fail(f"{out} is finished"))
    launch("train", command.run, WORDS)
    assert state(tmp_path) == before
