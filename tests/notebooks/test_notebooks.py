"""The notebooks run from top to bottom, and are written to be read."""

import ast
import os
import re
import sys
from pathlib import Path

import pytest

from anystyle.commands import plugins_check

pytest.importorskip("jupytext", reason="notebooks are paired by jupytext: pip install jupytext")

from tests.support.notebooks import FOLDER, NAMES, execute, stored, text


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_notebook_runs(name, tmp_path, monkeypatch):
    pytest.importorskip("nbclient", reason="notebooks are run by nbclient: pip install nbmake")
    monkeypatch.setenv("PATH", os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    assert not _wrong(execute(name, tmp_path))


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_stored_with_its_outputs(name):
    notebook, size = stored(name), (FOLDER / f"{name}.ipynb").stat().st_size
    assert [(cell.cell_type, cell.source) for cell in notebook.cells] == [
        (cell.cell_type, cell.source) for cell in text(name).cells
    ], "make notebooks writes it again"
    assert not _wrong(notebook)
    assert size < 400_000, f"{size} bytes"


def _wrong(notebook):
    """What a reader should not see."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    shown = [output for cell in cells for output in cell.outputs]
    wrong = [output for output in shown if output.get("name") == "stderr" or output.output_type == "error"]
    wrong += [cell for number, cell in enumerate(cells, start=1) if cell.execution_count != number]
    pictures = {kind for output in shown for kind in output.get("data", {}) if kind.startswith("image/")}
    return wrong or ([] if pictures else ["a notebook shows pictures"])


@pytest.mark.parametrize("name", NAMES)
def test_notebook_is_written_to_be_read(name):
    cells = text(name).cells
    assert cells[0].cell_type == "markdown"
    assert re.match(r"# \S", cells[0].source)
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    assert len([cell for cell in cells if cell.cell_type == "markdown"]) >= 0.5 * len(code)
    for source in code:
        assert len(source.splitlines()) <= 40, source
        ast.parse(re.sub(r"^# !.*$|^!.*$", "pass", source, flags=re.MULTILINE))


@pytest.mark.parametrize("name", NAMES)
def test_notebook_imports_what_there_is(name):
    """Renamed code is noticed without running the notebooks that take minutes."""
    for cell in text(name).cells:
        if cell.cell_type == "code":
            for line in re.findall(r"^from anystyle.*|^import anystyle.*", cell.source, re.MULTILINE):
                exec(line, {})


def test_the_backbone_of_the_notebook_is_a_plugin_with_two_lines_besides(tmp_path, monkeypatch, capsys):
    cells = [cell.source for cell in text("02_add_a_backbone").cells if cell.cell_type == "code"]
    last = next(place for place, source in enumerate(cells) if "class Relief(" in source)
    code = "\n\n".join(cells[: last + 1]).replace('@anystyle.plugin("backbone", "relief")\n', "")
    (tmp_path / "relief_of_a_notebook.py").write_text(code)
    lines = ['[project.entry-points."anystyle.backbone"]', 'relief = "relief_of_a_notebook:Relief"']
    (tmp_path / "pyproject.toml").write_text("\n".join(lines))
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path))
    monkeypatch.setattr("sys.path", list(sys.path))
    # Shapes of a plugin outside are checked by its contract, not by the types that this suite adds to annotations.
    assert plugins_check.main(["backbone", "relief"]) == 0, capsys.readouterr().out
    assert "promises kept" in capsys.readouterr().out
    sys.modules.pop("relief_of_a_notebook", None)
