"""Plugins of a class ``Mine`` in folders of their own, and how commands end with each."""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from tests.support.program import Done

RUN = """
import json, os, sys
from pathlib import Path
from tests.support.program import program

root, ended = Path(sys.argv[1]), {}
for name, words in json.loads(sys.argv[2]).items():
    ended[name] = program(words.split(), root, {**os.environ, "ANYSTYLE_PLUGINS": str(root / name)})
print(json.dumps(ended))
"""


def write_plugin(folder: Path, kind: str, code: str, name: str) -> None:
    """Declare the class of a module by a name."""
    folder.mkdir()
    (folder / f"bad_{folder.name}.py").write_text(code)
    line = f'{name} = "bad_{folder.name}:Mine"'
    (folder / "pyproject.toml").write_text(f'[project.entry-points."anystyle.{kind}"]\n{line}\n')


def ends(root: Path, commands: Mapping[str, str]) -> dict[str, Done]:
    """How a command with the plugin in ``root/NAME`` ends, by NAME, in a process in which nothing else checks types."""
    command = [sys.executable, "-c", RUN, str(root), json.dumps(commands)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=Path(__file__).parents[2])
    return {name: Done(*end) for name, end in json.loads(done.stdout).items()}
