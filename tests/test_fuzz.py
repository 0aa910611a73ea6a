"""The program that damages inputs, small: that it runs, and that every ending it draws is a good one."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from fuzz.kept import KEPT

FOLDER = Path(__file__).parent


def test_what_once_ended_badly_ends_well():
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-m", "fuzz", "--kept", "--seconds", "600"],
        cwd=FOLDER,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert sum(line.endswith(": fine ") for line in done.stdout.splitlines()) == len(KEPT)


@pytest.mark.slow
def test_works_that_meet_faults_lose_nothing(tmp_path):
    words = ["-m", "faults", "--kills", "12", "--others", "0", "--seed", "3", "--keep", str(tmp_path)]
    done = subprocess.run([sys.executable, "-W", "ignore", *words], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    rows = [json.loads(line) for line in (tmp_path / "trials-3.jsonl").read_text().splitlines()]
    assert len(rows) == 12 and not any(row["problem"] for row in rows)


@pytest.mark.slow
def test_a_few_damaged_inputs_end_well(tmp_path):
    words = ["-m", "fuzz", "--inputs", "20", "--seed", "2", "--keep", str(tmp_path)]
    done = subprocess.run([sys.executable, "-W", "ignore", *words], cwd=FOLDER, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.splitlines()[-1].endswith("{'fine': 20}")
    assert list(tmp_path.iterdir()) == []
