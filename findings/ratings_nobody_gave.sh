#!/usr/bin/env bash
# A rating that nobody gave: weighted kappas take the scale for shorter than it is, an ordered model loses its effect.
#
# Two people rate 200 pictures from 1 to 5. Nobody gives 2 or 3; they agree on what is a 1, and mix up 4 and 5.
#   quadratic kappa on the scale   0.88: torchmetrics 1.9.0 `multiclass_cohen_kappa`, which asks for the number of ratings;
#                                  scikit-learn 1.9.1 with `labels`, statsmodels 0.15.0 with `bins` of `to_table`
#   by the ratings that occur      0.61: scikit-learn and statsmodels without these; 1 and 4 are then neighbours, as 4 and
#                                  5 are. Linear: 0.68 and 0.50. No word
#   krippendorff 0.9.0             ordinal alpha: the same with and without `value_domain`, for its distances are counts
# statsmodels `OrderedModel` of a categorical that has a level nobody gave: an effect of 0.0 for 0.98 and standard errors
# of NaN, with warnings of logarithms and a Hessian; of one that has a last such level: "shapes not aligned".
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet scikit-learn==1.9.1 statsmodels==0.15.0 krippendorff==0.9.0 torchmetrics==1.9.0 torch==2.13.0 \
  numpy==2.4.6 scipy==1.17.1 pandas==2.3.3
env/bin/python - <<'PYTHON'
import warnings

import krippendorff
import numpy as np
import pandas as pd
import torch
from sklearn.metrics import cohen_kappa_score
from statsmodels.miscmodels.ordinal_model import OrderedModel
from statsmodels.stats.inter_rater import cohens_kappa, to_table
from torchmetrics.functional.classification import multiclass_cohen_kappa

random = np.random.default_rng(0)
SCALE = [1, 2, 3, 4, 5]


def rated(pictures):
    """Each person takes three in ten of the fours for fives, and of the fives for fours."""
    mixed = (random.random(200) < 0.3) & (pictures > 1)
    return np.where(mixed, 9 - pictures, pictures)


pictures = random.choice([1, 4, 5], 200, p=[0.1, 0.45, 0.45])
pairs = np.stack([rated(pictures), rated(pictures)], 1)
for weights in ("linear", "quadratic"):
    seen = {
        "scikit-learn": cohen_kappa_score(*pairs.T, weights=weights),
        "statsmodels": cohens_kappa(to_table(pairs)[0], wt=weights).kappa,
    }
    scale = {
        "scikit-learn, labels": cohen_kappa_score(*pairs.T, weights=weights, labels=SCALE),
        "statsmodels, bins": cohens_kappa(to_table(pairs, bins=np.arange(0.5, 6))[0], wt=weights).kappa,
        "torchmetrics": float(multiclass_cohen_kappa(*torch.tensor(pairs.T - 1), 5, weights=weights)),
    }
    for values in (seen, scale):
        print(weights, {name: round(float(value), 2) for name, value in values.items()})
        assert np.ptp(list(values.values())) < 1e-6
    assert scale["torchmetrics"] - seen["statsmodels"] > (0.15 if weights == "linear" else 0.25)
domains = ([1, 4, 5], SCALE)
alphas = [krippendorff.alpha(pairs.T, level_of_measurement="ordinal", value_domain=domain) for domain in domains]
print(f"krippendorff: {alphas[0]:.3f}, {alphas[1]:.3f}")
assert abs(alphas[0] - alphas[1]) < 1e-9
group = random.integers(0, 2, 400)
rating = np.array([1, 3, 4])[np.digitize(0.9 * group + random.logistic(size=400), [-1.0, 1.5])]
effects = []
for levels in ([1, 3, 4], [1, 2, 3, 4], [1, 3, 4, 5]):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        ratings = pd.Series(pd.Categorical(rating, categories=levels, ordered=True))
        try:
            model = OrderedModel(ratings, pd.DataFrame({"group": group}), distr="logit").fit(method="bfgs", disp=0)
            effects.append((float(model.params["group"]), float(model.bse["group"])))
        except ValueError as error:
            effects.append(str(error))
    print(f"levels {levels}: {effects[-1]}, {len(caught)} warnings")
assert effects[0][0] > 0.5 and effects[1][0] == 0 and np.isnan(effects[1][1]) and "aligned" in effects[2]
PYTHON
echo "as described"
