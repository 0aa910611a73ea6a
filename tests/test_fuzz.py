"""The program that damages inputs, small: that it runs, and that every ending it draws is a good one."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_a_few_damaged_inputs_end_well(tmp_path):
    words = ["-m", "fuzz", "--inputs", "20", "--seed", "2", "--keep", str(tmp_path)]
    done = subprocess.run(
        [sys.executable, "-W", "ignore", *words], cwd=Path(__file__).parent, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].endswith("{'fine': 20}")
    assert list(tmp_path.iterdir()) == []
