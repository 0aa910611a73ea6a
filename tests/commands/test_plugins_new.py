"""What `anystyle plugins new` writes works at once; what it refuses leaves nothing behind."""

import os
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from anystyle.commands import plugins_check, plugins_new
from anystyle.errors import UserError
from anystyle.registry.catalog import kinds
from anystyle.registry.compose import compose
from tests.support.refusals import raises_line

ROOT = Path(__file__).parents[2]
KINDS = kinds()


@pytest.fixture(scope="module")
def written(tmp_path_factory) -> Path:
    """A folder with a new plugin of each kind."""
    into = tmp_path_factory.mktemp("new")
    for kind in KINDS:
        assert plugins_new.main([kind, f"my_{kind}", "--into", str(into)]) == 0
    return into


@pytest.fixture
def listed(written: Path, monkeypatch) -> Path:
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(written))
    monkeypatch.setattr("sys.path", list(sys.path))
    return written


@pytest.mark.parametrize("kind", KINDS)
def test_a_new_plugin_is_found_and_keeps_its_contract(kind, listed, capsys):
    assert plugins_check.main([kind, f"my_{kind}"]) == 0
    assert f"{kind} 'my_{kind}' (anystyle_my_{kind}:" in capsys.readouterr().out
    assert "Toy" not in (listed / f"my_{kind}" / f"anystyle_my_{kind}.py").read_text()


@pytest.mark.usefixtures("listed")
def test_a_new_injector_fits_the_recipe_of_the_ablation():
    assert compose("train", ["experiment=tiny_ablation", "injector=my_injector"]).injector.gain == 11.3


def test_it_is_formatted_as_the_project_is(written):
    config = ["--config", str(ROOT / "pyproject.toml"), "--no-cache"]
    for command in (["check", "--ignore", "T201"], ["format", "--check"]):
        done = subprocess.run([sys.executable, "-m", "ruff", *command, *config, str(written)], capture_output=True)
        assert done.returncode == 0, done.stdout.decode()


@pytest.mark.slow
def test_its_own_test_runs_in_its_folder(written):
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("ANYSTYLE_PLUGINS", None)
    command, folder = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider"], written / "my_placement"
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
    assert "1 passed" in done.stdout


def test_it_is_a_package_that_can_be_built(written, tmp_path):
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(tmp_path), "my_injector"]
    done = subprocess.run(command, cwd=written, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        assert "anystyle_my_injector.py" in archive.namelist()
        (points,) = [name for name in archive.namelist() if name.endswith("entry_points.txt")]
        assert "[anystyle.injector]\nmy_injector = anystyle_my_injector:MyInjector" in archive.read(points).decode()


def test_what_comes_next_is_said(tmp_path, capsys):
    plugins_new.main(["loss", "mine", "--into", str(tmp_path)])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == f"wrote {tmp_path}/mine: anystyle_mine.py, pyproject.toml, test_anystyle_mine.py, README.md"
    assert lines[1] == f"next:  ANYSTYLE_PLUGINS={tmp_path} anystyle plugins check loss mine"


def test_a_name_that_would_hide_an_import_gets_another_class(tmp_path):
    folder = plugins_new.write("backbone", "embedder", tmp_path)
    assert "class MyEmbedder(Backbone)" in (folder / "anystyle_embedder.py").read_text()
    assert 'embedder = "anystyle_embedder:MyEmbedder"' in (folder / "pyproject.toml").read_text()


@pytest.mark.parametrize(
    ("kind", "name", "told"),
    [
        ("backbones", "mine", "no kind of plugin is named 'backbones'. Did you mean 'backbone'?"),
        ("placement", "head", "placement 'head' is declared already by anystyle"),
        ("backbone", "anysplat_tiny", "'anysplat_tiny' is a preset of backbone already"),
        ("loss", "two words", "cannot name a plugin"),
        ("loss", "../escape", "cannot name a plugin"),
        ("loss", "class", "cannot name a plugin"),
        ("loss", "backbones", "the module anystyle_backbones belongs to backbone 'anysplat'"),
    ],
)
def test_names_that_cannot_be_used(kind, name, told, tmp_path):
    with raises_line(UserError, naming=told):
        plugins_new.main([kind, name, "--into", str(tmp_path)])
    assert list(tmp_path.iterdir()) == []


def test_a_folder_is_never_overwritten(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "work.py").write_text("x = 1\n")
    with pytest.raises(UserError, match="exists already; choose another NAME or --into DIR, nothing was written"):
        plugins_new.main(["loss", "mine", "--into", str(tmp_path)])
    assert [file.name for file in (tmp_path / "mine").iterdir()] == ["work.py"]
