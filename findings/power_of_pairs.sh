#!/usr/bin/env bash
# pingouin 0.7.0: beside a paired t-test stands the power of another test, 0.10 of a study that finds its effect.
#
# Twelve people give two methods a mark each, and differ more from one another than the methods do. Seen, for people
# whose two marks go together (a correlation of 0.98, or 0.5) and who answer the other way round (-0.7):
#                                                      0.98      0.5       -0.7
#   p of the paired test                               0.005     0.078     0.093
#   `power` in the row of `ttest(x, y, paired=True)`   0.10      0.43      0.87
#   how often such a study finds the difference        0.88      0.43      0.39
#   statsmodels 0.15.0, TTestPower, of the mean difference over the spread of differences: as often
#   people for a power of 0.8, of its `cohen_d`        199       28        11
#   and right                                          10        28        30
# `cohen_d`, and `hedges` of `pairwise_tests`, divide by the spread of people, while `power_ttest(contrast="paired")`
# wants the spread of differences; `ttest` hands it the former. No warning. Divide by the spread of x - y.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet pingouin==0.7.0 statsmodels==0.15.0 scipy==1.17.1 pandas==2.3.3 numpy==2.4.6
env/bin/python - <<'PYTHON'
import math
import warnings

import numpy as np
import pingouin
from scipy import stats
from statsmodels.stats.power import TTestPower

random = np.random.default_rng(0)
PEOPLE = 12


def marks(correlation, gap):
    """Two marks a person, whose sample has exactly this correlation, spreads of 1, and this gap of means."""
    raw = random.normal(size=(PEOPLE, 2))
    raw -= raw.mean(0)
    raw = raw @ np.linalg.inv(np.linalg.cholesky(np.cov(raw.T)).T)
    mixed = raw @ np.linalg.cholesky([[1, correlation], [correlation, 1]]).T
    return mixed[:, 0] + gap, mixed[:, 1]


def often(correlation, gap, draws=20000):
    """In how many of new studies of the same population the paired test gets below 0.05."""
    gaps = random.normal(gap, math.sqrt(2 - 2 * correlation), (draws, PEOPLE))
    return (stats.ttest_1samp(gaps, 0, axis=1).pvalue < 0.05).mean()


def people(effect):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return math.ceil(pingouin.power_ttest(d=effect, power=0.8, contrast="paired"))


for correlation, gap, expected in (
    (0.98, 0.2, (0.005, 0.10, 0.89, 199, 10)),
    (0.5, 0.56, (0.078, 0.43, 0.43, 28, 28)),
    (-0.7, 0.98, (0.093, 0.87, 0.39, 11, 30)),
):
    x, y = marks(correlation, gap)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        row = pingouin.ttest(x, y, paired=True).iloc[0]
    own = gap / np.std(x - y, ddof=1)
    right = TTestPower().power(own, PEOPLE, 0.05)
    found = row.p_val, row.power, often(correlation, gap), people(row.cohen_d), people(own)
    print(f"r {correlation}: p {found[0]:.2g}, power by pingouin {found[1]:.3f}, seen {found[2]:.3f}, "
          f"statsmodels {right:.3f}, d {row.cohen_d:.3f} for {own:.3f}, people {found[3]} for {found[4]}")
    assert np.allclose(found[:3], expected[:3], rtol=0.02, atol=0.012) and found[3:] == expected[3:]
    assert abs(right - expected[2]) < 0.01 and not caught
PYTHON
echo "as described"
