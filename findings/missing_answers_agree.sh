#!/usr/bin/env bash
# statsmodels 0.14.6: aggregate_raters takes a missing answer for a category of its own, and fleiss_kappa follows it.
#
# Answers of a user study are a table with a row an item and a column a person, and NaN where somebody gave none:
#   six people who agree in most of 200 items                         kappa 0.72
#   the same people, three in ten of their answers missing            kappa 0.22
#   six people who answer at random                                   kappa -0.02
#   the same people, and 150 items that nobody was asked              kappa 0.56
# There is no word, but that the categories returned are [0, 1, nan]. Krippendorff's nominal alpha (krippendorff 0.9.0)
# of the same four tables is 0.72, 0.70, -0.02 and -0.02.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet statsmodels==0.14.6 krippendorff==0.9.0 numpy==2.4.6 scipy==1.17.1 pandas==3.0.3
env/bin/python -W error - <<'PYTHON'
import krippendorff
import numpy as np
from statsmodels.stats.inter_rater import aggregate_raters, fleiss_kappa

random = np.random.default_rng(0)
truth = random.integers(0, 2, (200, 1))
agreed = np.where(random.random((200, 6)) < 0.08, 1 - truth, truth).astype(float)
gaps = np.where(random.random(agreed.shape) < 0.3, np.nan, agreed)
guessed = random.integers(0, 2, (200, 6)).astype(float)
unasked = np.concatenate([guessed, np.full((150, 6), np.nan)])
kappas, alphas = [], []
for name, answers in {"agreed": agreed, "gaps": gaps, "guessed": guessed, "unasked": unasked}.items():
    counts, categories = aggregate_raters(answers)
    kappas.append(fleiss_kappa(counts))
    alphas.append(krippendorff.alpha(reliability_data=answers.T, level_of_measurement="nominal"))
    print(f"{name}: categories {categories}, kappa {kappas[-1]:.2f}, alpha {alphas[-1]:.2f}")
    assert len(categories) == (3 if np.isnan(answers).any() else 2)
assert kappas[0] > 0.6 and kappas[1] < 0.3
assert abs(kappas[2]) < 0.05 and kappas[3] > 0.5
assert abs(alphas[0] - alphas[1]) < 0.03 and max(map(abs, alphas[2:])) < 0.05
PYTHON
echo "as described"
