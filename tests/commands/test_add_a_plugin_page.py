"""docs/add_a_plugin.md: every command it shows runs, and every file it shows is what they run on."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from anystyle.registry.builtin import KINDS

PAGE = (Path(__file__).parents[2] / "docs" / "add_a_plugin.md").read_text(encoding="utf-8")


def _blocks(language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_every_kind_is_there_with_its_contract():
    rows = dict(re.findall(r"^\| `(\w+)`(?:\\\*)? \| `([\w.]+)` \|", PAGE, re.MULTILINE))
    assert rows == {kind: row.base.replace(":", ".") for kind, row in KINDS.items()}


@pytest.mark.parametrize("block", _blocks("console"), ids=["new", "by_hand"])
def test_commands(block, tmp_path):
    (tmp_path / "sparse").mkdir()
    (code,) = [text for text in _blocks("python") if "class Sparse" in text]
    (tmp_path / "sparse" / "sparse.py").write_text(code)
    (tmp_path / "sparse" / "pyproject.toml").write_text(_blocks("toml")[0])
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    environment.pop("ANYSTYLE_PLUGINS", None)
    shown = []
    for line in block.splitlines():
        program, *words = shlex.split(line.removeprefix("$ "))
        if program == "export":
            name, _, value = words[0].partition("=")
            environment[name] = value
            continue
        assert program == "anystyle"
        done = subprocess.run(
            [sys.executable, "-m", "anystyle", *words], cwd=tmp_path, env=environment, capture_output=True, text=True
        )
        assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
        shown.append(done.stdout)
    told = "".join(shown)
    assert "promises kept" in told
    assert "broken" not in told
    if "placement.step=3" in block:
        assert "_target_: sparse.Sparse\nstep: 3" in told


def test_its_own_test_passes(monkeypatch):
    # Run as written, on the class as written.
    space: dict[str, object] = {"__name__": "page"}
    monkeypatch.setitem(sys.modules, "page", type(sys)("page"))
    for text in _blocks("python"):
        if "class Sparse" in text or "def test_contract" in text:
            exec(compile(text, "add_a_plugin.md", "exec"), space)
    space["test_contract"]()
