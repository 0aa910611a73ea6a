"""The wheel alone, in an environment that holds nothing of this project, does the main job from any folder."""

import json
import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from plyfile import PlyData

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory):
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    return next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def environment(wheel, tmp_path_factory):
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    own = Path(sysconfig.get_path("purelib", vars={"base": str(folder), "platbase": str(folder)}))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(own)
    # The dependencies, but not this project: path files in that folder, such as an editable install's, are not read.
    (own / "dependencies.pth").write_text(sysconfig.get_path("purelib") + "\n")
    return folder / "bin" / "python"


def test_it_carries_configurations_plugins_and_weights(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    assert {f"anystyle/examples/{file}" for file in ("index.json", "street/LICENCE.txt", "street/12.jpg")} <= {*names}
    assets = ROOT / "plugins/magenta/anystyle_magenta/assets"
    paths = [*(ROOT / "conf").rglob("*.yaml"), *ROOT.glob("plugins/*/pyproject.toml"), *assets.iterdir()]
    parts = [path.relative_to(ROOT).as_posix() for path in paths]
    files = ("magenta/LICENSE", "magenta/NOTICE", "magenta/anystyle_magenta/conf/model/painter.yaml")
    files += ("tiny/anystyle_tiny/procedural/words.toml", "cpu_renderer/anystyle_cpu_renderer/renderer.py")
    assert {f"anystyle/_shared/{part}" for part in [*parts, *(f"plugins/{file}" for file in files)]} <= {*names}
    assert any(name.startswith("anystyle/assets/") and name.endswith(".safetensors") for name in names)
    assert not [name for name in names if "__pycache__" in name or name.endswith((".nbi", ".nbc"))]


def test_packages_of_plugins_can_be_imported_before_anystyle(environment, tmp_path):
    names = sorted(path.parent.name for path in ROOT.glob("plugins/*/anystyle_*/__init__.py"))
    code = "import sys, importlib.util as u; print(*(name for name in sys.argv[1:] if not u.find_spec(name)))"
    run = subprocess.run([environment, "-c", code, *names], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert len(names) > 10 and (run.stdout, run.stderr) == ("\n", "")


@pytest.mark.slow
def test_it_stylizes_from_another_folder(environment, tmp_path):
    clean = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "ANYSTYLE"))}
    command = [environment, "-m", "anystyle", "stylize", "scenes=procedural", "--text", "red and white stripes"]
    options = ["--out", "result", "scenes.size=56", "views.take=2", "video.frames=2", "video.scale=0.5"]
    run = subprocess.run([*command, *options], cwd=tmp_path, env=clean, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    report = json.loads((tmp_path / "result" / "report.json").read_text())
    assert report["views"] == 2
    assert PlyData.read(tmp_path / "result" / "scene.ply")["vertex"].count == report["gaussians"]
    code = "import anystyle; print(anystyle.__file__)"
    where = subprocess.run([environment, "-c", code], cwd=tmp_path, env=clean, capture_output=True, text=True)
    assert str(ROOT) not in where.stdout
