"""What a step costs at full width: measured, many minutes on one core."""

import pytest

from benchmarks.step_cost import Case, compare


@pytest.mark.slow
def test_what_is_frozen_is_neither_differentiated_nor_kept():
    found = compare(Case(depth=12, side=224, views=2, objective="paper", steps=1))
    assert found["time ratio"] <= 0.6, found
    assert found["memory ratio"] <= 0.6, found
