"""Plugin folders made for a test."""

import itertools
import os
from collections.abc import Callable
from pathlib import Path
from textwrap import dedent

import pytest

_serial = itertools.count()


@pytest.fixture
def plugin_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Path]:
    """Make a folder of one plugin, listed in ANYSTYLE_PLUGINS: ``plugin_folder(code, "placement", name="Class")``.

    The module has a name of its own every time, since Python imports one only once a process.
    """

    def make(code: str, kind: str = "placement", *, folder: str | None = None, toml: str | None = None, **names: str):
        number = next(_serial)
        module = f"made_for_a_test_{os.getpid()}_{number}"
        root = tmp_path / (folder or f"plugin{number}")
        root.mkdir()
        rows = "\n".join(f'{name} = "{module}:{target}"' for name, target in names.items())
        text = toml if toml is not None else f'[project.entry-points."anystyle.{kind}"]\n{rows}\n'
        (root / "pyproject.toml").write_text(text)
        (root / f"{module}.py").write_text(dedent(code))
        before = [word for word in os.environ.get("ANYSTYLE_PLUGINS", "").split(os.pathsep) if word]
        monkeypatch.setenv("ANYSTYLE_PLUGINS", os.pathsep.join([*before, str(root)]))
        return root

    monkeypatch.delenv("ANYSTYLE_PLUGINS", raising=False)
    monkeypatch.setattr("sys.path", list(__import__("sys").path))
    return make
