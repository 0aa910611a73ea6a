"""The scripts beside this file can be started as the docs say: nothing but ``tests`` has to be on the path."""

import os
import subprocess
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
START = """
import runpy, sys
for script in sys.argv[1:]:
    assert callable(runpy.run_path(script, run_name="started")["main"]), script
"""


def test_scripts_find_what_they_import():
    scripts = [path for path in sorted(FOLDER.glob("*.py")) if "\nif __name__ ==" in path.read_text(encoding="utf-8")]
    path = os.pathsep.join([str(FOLDER), str(FOLDER.parent)])  # a script's own folder is there when it is run
    words = [sys.executable, "-c", START, *map(str, scripts)]
    ended = subprocess.run(words, env={**os.environ, "PYTHONPATH": path}, capture_output=True, text=True, check=False)
    assert len(scripts) > 5 and ended.returncode == 0, ended.stderr
