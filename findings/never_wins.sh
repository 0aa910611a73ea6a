#!/usr/bin/env bash
# choix 0.4.1: a method that never wins has no strength in a Bradley-Terry model, and five estimators say so in three ways.
#
# The likelihood has no maximum: the strength of such a method falls without end. 20 answers among three methods, of
# which the second loses all of its ten:
#   ilsr_pairwise, mm_pairwise            RuntimeError "Did not converge"
#   lsr_pairwise, rank_centrality         inf and nan for all three, a RuntimeWarning
#   opt_pairwise                          a finite number, no word: -8.7
# The last is a small default prior (alpha=1e-6) at work, so that it measures how often one asked: the same answers ten
# times over give -10.1, a hundred times -11.6, while strengths of methods that do win stay as they are.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet choix==0.4.1 numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import warnings

import choix
import numpy as np

answers = [(0, 1)] * 10 + [(0, 2)] * 6 + [(2, 0)] * 4
for name in ("ilsr_pairwise", "mm_pairwise"):
    try:
        with warnings.catch_warnings(action="ignore"):
            getattr(choix, name)(3, answers)
    except RuntimeError as error:
        print(f"{name}: {error}")
        assert "Did not converge" in str(error)
    else:
        raise AssertionError(name)
for name in ("lsr_pairwise", "rank_centrality"):
    with warnings.catch_warnings(record=True, action="always") as told:
        strengths = getattr(choix, name)(3, answers)
    assert {one.category for one in told} == {RuntimeWarning}
    print(f"{name}: {strengths}")
    assert not np.isfinite(strengths).any()
with warnings.catch_warnings(action="error"):
    found = [choix.opt_pairwise(3, answers * times) for times in (1, 10, 100)]
for strengths in found:
    print(f"opt_pairwise: {np.round(strengths, 2)}, methods that win apart by {strengths[0] - strengths[2]:.3f}")
worst = [strengths[1] for strengths in found]
assert worst[0] > worst[1] + 1 > worst[2] + 2 and np.isfinite(worst).all()
assert np.ptp([strengths[0] - strengths[2] for strengths in found]) < 0.01
PYTHON
echo "as described"
