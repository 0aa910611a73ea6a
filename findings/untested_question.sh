#!/usr/bin/env bash
# One test of four without a p-value: what statsmodels 0.15.0, pingouin 0.7.0 and scikit-posthocs make of the others.
#
# A test of methods that everybody rated alike gives NaN. Which of p = 0.01, 0.02 and 0.03 are rejected at 0.05:
#                                 alone by statsmodels    beside NaN, by statsmodels' multipletests      by pingouin
#   holm                          all three               the first: four tests are counted              all three
#   fdr_bh                        all three               all three, and adjusted p are NaN for all      all three
#   hommel                        all three               none, adjusted p are NaN for all               not there
#   simes-hochberg                all three               the first, adjusted p are NaN for all          not there
# Of 0.001, 0.04, 0.04 by fdr_bh: the first by statsmodels, all three by pingouin. No warning by either.
# scikit-posthocs 0.17.1, posthoc_ttest with p_adjust="fdr_bh", two of four methods constant and equal: the pair has no
# p-value, and the table is NaN but for its diagonal; with "holm" that pair alone is.
# SciPy 1.17.1 `false_discovery_control` raises. Leave out what has no p-value, and say so.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet statsmodels==0.15.0 pingouin==0.7.0 scikit-posthocs==0.17.1 scipy==1.17.1 numpy==2.4.6 \
    pandas==2.3.3 scikit-learn==1.9.1
env/bin/python - <<'PYTHON'
import warnings

import numpy as np
import pingouin
import scikit_posthocs
from scipy.stats import false_discovery_control
from statsmodels.stats.multitest import multipletests

missing, three = float("nan"), [0.01, 0.02, 0.03]
with warnings.catch_warnings():
    warnings.simplefilter("error")
    for method, rejected, adjusted in (
        ("holm", [True, False, False, False], [0.04, 0.06, 0.06, missing]),
        ("fdr_bh", [True, True, True, False], [missing] * 4),
        ("hommel", [False] * 4, [missing] * 4),
        ("simes-hochberg", [True, False, False, False], [missing] * 4),
    ):
        alone, beside = multipletests(three, method=method), multipletests([*three, missing], method=method)
        print(f"statsmodels, {method}: alone {alone[0]} {alone[1].round(3)}, beside {beside[0]} {beside[1].round(3)}")
        assert alone[0].all() and np.isfinite(alone[1]).all()
        assert beside[0].tolist() == rejected and np.allclose(beside[1], adjusted, equal_nan=True)
    for method in ("holm", "fdr_bh"):
        rejected, adjusted = pingouin.multicomp([*three, missing], method=method)
        print(f"pingouin, {method}: {rejected} {adjusted}")
        assert rejected.tolist() == [True, True, True, False]
        assert np.allclose(adjusted[:3], multipletests(three, method=method)[1]) and np.isnan(adjusted[3])
    other = [0.001, 0.04, 0.04, missing]
    assert multipletests(other, method="fdr_bh")[0].tolist() == [True, False, False, False]
    assert pingouin.multicomp(other, method="fdr_bh")[0].tolist() == [True, True, True, False]
try:
    false_discovery_control([*three, missing])
except ValueError as error:
    print("scipy:", error)
else:
    raise AssertionError

rng = np.random.default_rng(0)
ratings = [np.full(8, 3.0), np.full(8, 3.0), rng.integers(3, 6, 8) * 1.0, rng.integers(3, 6, 8) * 1.0]
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    tables = {name: scikit_posthocs.posthoc_ttest(ratings, p_adjust=name).to_numpy() for name in ("holm", "fdr_bh")}
print({str(warning.message)[:60] for warning in caught})
assert not [warning for warning in caught if "p-value" in str(warning.message) or "adjust" in str(warning.message)]
for name, table in tables.items():
    print(f"scikit-posthocs, {name}:\n{table.round(3)}")
pair = np.zeros((4, 4), bool)
pair[0, 1] = pair[1, 0] = True
assert np.array_equal(np.isnan(tables["holm"]), pair)
assert np.array_equal(np.isnan(tables["fdr_bh"]), ~np.eye(4, dtype=bool))
PYTHON
echo "as described"
