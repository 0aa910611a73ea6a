"""A small trial of the large one: four jobs, a few faults that need no disk of their own."""

import shutil
import sys

import pytest

from tests.benchmarks.kills import KINDS, Trial


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="processes have a parent that takes their signals there")
def test_a_sweep_that_is_disturbed_ends_with_the_same_bytes(tmp_path):
    kinds = {kind: often for kind, often in KINDS.items() if kind not in ("full", "read-only")}
    trial = Trial(tmp_path, "joblib", seed=0, seeds="0", kinds=kinds)
    try:
        expected = trial.whole()
        while sum(trial.counts.values()) < 4:
            shutil.rmtree(trial.sweep)
            assert trial.disturbed(4) == expected
    finally:
        trial.close()
