"""The scripts beside this file can be started as the docs say: ``python -m tests.benchmarks.NAME``."""

import subprocess
import sys
from pathlib import Path

START = """
import runpy, sys
for script in sys.argv[1:]:
    assert callable(runpy.run_module(script, run_name="started")["main"]), script
"""


def test_scripts_find_what_they_import():
    scripts = [
        path for path in sorted(Path(__file__).parent.glob("*.py")) if "\nif __name__ ==" in path.read_text("utf-8")
    ]
    command = [sys.executable, "-c", START, *(f"tests.benchmarks.{path.stem}" for path in scripts)]
    root = Path(__file__).parents[2]
    ended = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    assert len(scripts) > 3 and ended.returncode == 0, ended.stderr
