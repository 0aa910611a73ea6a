"""The notebooks run from top to bottom, and are written to be read."""

import ast
import os
import re
import sys
import time
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[2] / "notebooks"
NAMES = [path.name for path in sorted(FOLDER.glob("*.py"))]
LONGEST = 120.0
"""Seconds that a notebook may take."""


def read(name):
    jupytext = pytest.importorskip("jupytext", reason="notebooks are paired by jupytext: pip install jupytext")
    return jupytext.read(FOLDER / name)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_notebook_runs(name, tmp_path, monkeypatch):
    client = pytest.importorskip("nbclient", reason="notebooks are run by nbclient: pip install nbmake")
    # Commands of a notebook are those of this environment.
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = read(name)
    start = time.process_time() + _children()
    client.NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": tmp_path}}
    ).execute()
    assert time.process_time() + _children() - start < LONGEST
    shown = [output for cell in notebook.cells if cell.cell_type == "code" for output in cell.outputs]
    assert not [output for output in shown if output.get("name") == "stderr"], shown
    kinds = {kind for output in shown for kind in output.get("data", {})}
    assert kinds & {"image/png", "image/gif", "image/svg+xml"}, "a notebook shows pictures"


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_written_to_be_read(name):
    cells = read(name).cells
    assert cells[0].cell_type == "markdown"
    assert re.match(r"# \S", cells[0].source)
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    prose = [cell for cell in cells if cell.cell_type == "markdown"]
    assert len(prose) >= 0.5 * len(code)
    for source in code:
        assert len(source.splitlines()) <= 40, source
        ast.parse(re.sub(r"^# !.*$|^!.*$", "pass", source, flags=re.MULTILINE))


def _children() -> float:
    import resource

    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime
