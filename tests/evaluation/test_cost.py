"""The program that says what judging costs: both of its ways find the same figures, and it says what each takes."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = Path(__file__).parents[1] / "evaluation_cost.py"


# RAFT halves an eighth of the side three times and needs two cells then, so less than 128 pixels are no numbers.
@pytest.mark.slow
def test_both_ways_agree_and_are_timed():
    words = ["--size", "128", "--styles", "1", "--frames", "8"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    done = subprocess.run([sys.executable, PROGRAM, *words], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert "1 styles x 8 frames at 128 pixels, 1 thread(s)" in lines
    for name in ("art_fid", "warp_consistency", "all"):
        (line,) = (line for line in lines if line.startswith(f"{name} "))
        ours, corrected, pairs = (float(value) for value in re.findall(r"(\d+\.\d) s", line))
        assert min(ours, corrected, pairs) > 0, line
