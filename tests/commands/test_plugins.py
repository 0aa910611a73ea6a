"""What `anystyle plugins` shows."""

import os
import subprocess
import sys

import pytest

import anystyle.registry.catalog as module
from anystyle.commands.plugins import main
from anystyle.contracts import Placement
from anystyle.registry.builtin import BUILTIN, KINDS, MANY
from anystyle.registry.catalog import plugin

MODEL = '''
raise RuntimeError("imported")
from typing import Literal
from anystyle.contracts import Placement
class Deep(Placement):
    """Goes deep.

    Args:
        depth: How deep; a description that
            goes on.
        mode: Which way.
    """
    def __init__(self, sites_seen: int, *, depth: int = 2, mode: Literal["a", "b"] = "a", root: str) -> None: ...
    def select(self, sites): return tuple(sites)
'''


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A plugin whose module cannot be imported, and two that are not there."""
    package = tmp_path / "acme" / "acme_of_a_test"
    package.mkdir(parents=True)
    (package / "__init__.py").touch()
    (package / "model.py").write_text(MODEL)
    (tmp_path / "acme" / "pyproject.toml").write_text(
        '[project.entry-points."anystyle.placement"]\nacme = "acme_of_a_test.model:Deep"\n'
        'lost = "acme_of_a_test:Lost"\ngone = "acme_of_a_test.nowhere:Lost"\n'
    )
    monkeypatch.setenv("ANYSTYLE_PLUGINS", str(tmp_path))
    monkeypatch.setattr("sys.path", list(sys.path))
    yield tmp_path / "acme"
    for name in [name for name in sys.modules if name.partition(".")[0] == "acme_of_a_test"]:
        del sys.modules[name]


def shown(capsys, *words: str) -> str:
    main(list(words))
    return capsys.readouterr().out


def test_overview_names_everything(capsys):
    text = shown(capsys)
    for kind in KINDS:
        assert f"{kind}{'*' if kind in MANY else ''} " in text
    for rows in BUILTIN.values():
        assert all(name in text for name in rows)


def test_a_kind_is_described_from_source(capsys, folder):
    text = shown(capsys, "placement")
    assert f"Goes deep. [{folder}]" in " ".join(text.split()) and "(not described in acme_of_a_test:Lost)" in text
    assert "(not described in acme_of_a_test.nowhere:Lost)" in text


def test_a_plugin_is_shown_in_full(capsys, folder):
    model = folder / "acme_of_a_test" / "model.py"
    model.write_text(MODEL.replace('raise RuntimeError("imported")\n', ""))
    text = shown(capsys, "placement", "acme")
    assert text.startswith("placement=acme  (acme_of_a_test.model:Deep, declared by ")
    assert "  placement.depth: int = 2\n      How deep; a description that goes on.\n" in text
    assert "  placement.mode: 'a' | 'b' = 'a'\n      Which way." in text
    assert "  placement.root: str  (must be given)" in text


def test_problems_are_told_once(tmp_path):
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "pyproject.toml").write_text("[project")
    command, environment = [sys.executable, "-m", "anystyle", "plugins"], {"ANYSTYLE_PLUGINS": str(tmp_path)}
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment)
    assert done.returncode == 0
    assert done.stderr.startswith(f"ignored: {tmp_path}/bad/pyproject.toml cannot be read: ")
    assert done.stderr.count("\n") == 1


def test_a_class_of_this_process(monkeypatch, capsys):
    monkeypatch.setattr(module, "_OWN", {})

    @plugin("placement", "noted")
    class Noted(Placement):
        """Written in a notebook."""

        def select(self, sites):
            return tuple(sites)

    assert "Written in a notebook.  [this process]" in shown(capsys, "placement")
