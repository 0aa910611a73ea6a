#!/usr/bin/env bash
# Scores of depths and heights far from zero, torchmetrics 1.9.0: R2 of 0.88 becomes 0.00 or 1.0008, silently.
#
# 5000 numbers between d and d + 1, and the same with noise of 0.1, in float32 as networks give them: heights of a map,
# depths of a wall far away. In ten updates; the right values are of the same float32 numbers, by scikit-learn 1.9.1
# and NumPy in double precision:
#   d                              0         100       1000            10000           right
#   R2Score                        0.880     0.884     0.00            1.0008          0.880
#   ExplainedVariance              0.880     0.884     0.00            1.0006          0.880
#   RelativeSquaredError           0.120     0.116     423 million     423 million     0.120
#   NormalizedRootMeanSquaredError, normalization="std"
#                                  0.346     0.346     0.335           0.133           0.346
#   PearsonCorrCoef, ConcordanceCorrCoef, scikit-learn's r2_score in float32    right everywhere
# Sums of squares are kept in float32 and subtracted; with other noise 0.95 and 0.998 came out, which look like scores.
# No warning. `metric.set_dtype(torch.float64)` and updates in double precision are right; or subtract d first.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 scikit-learn==1.9.1 numpy==2.4.6 setuptools==80.9.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import numpy as np
import torch
from sklearn.metrics import r2_score
from torchmetrics.regression import (
    ConcordanceCorrCoef, ExplainedVariance, NormalizedRootMeanSquaredError, PearsonCorrCoef, R2Score,
    RelativeSquaredError,
)

torch.set_num_threads(1)
random = np.random.default_rng(0)
base = random.uniform(size=5000)
noisy = base + random.normal(0, 0.1, 5000)


def updated(metric, prediction, truth, dtype=torch.float32):
    metric = metric.set_dtype(dtype)
    for one, other in zip(np.split(prediction, 10), np.split(truth, 10)):
        metric.update(torch.tensor(one, dtype=dtype), torch.tensor(other, dtype=dtype))
    return float(metric.compute())


for distance, wrong in ((0, 0), (100, 0.002), (1000, 0.04), (10000, 0.1)):
    prediction, truth = ((values + distance).astype(np.float32) for values in (noisy, base))
    p, t = prediction.astype(float), truth.astype(float)
    error, variance = np.mean((p - t) ** 2), t.var()
    unbiased = np.cov(p, t)
    right = {
        "R2Score": (R2Score(), r2_score(t, p)),
        "ExplainedVariance": (ExplainedVariance(), 1 - (p - t).var() / variance),
        "RelativeSquaredError": (RelativeSquaredError(), error / variance),
        "NRMSE": (NormalizedRootMeanSquaredError(normalization="std"), np.sqrt(error / variance)),
    }
    for name, (metric, value) in right.items():
        found = updated(metric, prediction, truth)
        metric.reset()
        double = updated(metric, p, t, torch.float64)
        print(f"{distance:6} {name:21} {found:.4f}, in double precision {double:.4f}, right {value:.4f}")
        assert abs(double - value) < 1e-3
        if name == "NRMSE":
            assert abs(found - value) < 0.005 if distance < 1000 else abs(found - value) > 0.01
        else:
            assert abs(found - value) < 1e-3 if distance == 0 else abs(found - value) < 0.005 or distance >= 1000
            assert distance < 1000 or abs(found - value) > wrong
    pearson = updated(PearsonCorrCoef(), prediction, truth)
    concordance = updated(ConcordanceCorrCoef(), prediction, truth)
    agreement = 2 * unbiased[0, 1] / (unbiased[0, 0] + unbiased[1, 1] + (p.mean() - t.mean()) ** 2)
    single = r2_score(truth, prediction)
    print(f"{distance:6} Pearson {pearson:.4f}, concordance {concordance:.4f}; scikit-learn, float32 {single:.4f}")
    assert abs(pearson - np.corrcoef(p, t)[0, 1]) < 2e-3 and abs(concordance - agreement) < 2e-3
    assert abs(single - r2_score(t, p)) < 2e-3
PYTHON
echo "as described"
