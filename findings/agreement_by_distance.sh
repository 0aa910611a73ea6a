#!/usr/bin/env bash
# People who agree to within a step of a scale of ten, by four packages: agreement of 0.94, 0.58, -0.2 and -4.0.
#
# Four people rate 60 pictures from 1 to 10, each at most one step off the truth; and four who guess. With squares of
# differences as the distance:
#   0.94, guesses -0.1    Krippendorff's alpha by krippendorff 0.9.0, nltk 3.10.4 and irrCAC 0.4.4; quadratic
#                         kappa, the mean over pairs, by scikit-learn 1.9.1
#   0.58     irrCAC and scikit-learn, the same ratings as text, as read from a file: "10" comes before "2"
#   nltk, AnnotationTask(distance=interval_distance)
#     kappa, multi_kappa, pi, S         -0.2, guesses -19.9: chance is that of equal answers, whatever the distance is
#     the same with distances over 81   0.985, guesses 0.74
#     weighted_kappa(max_distance=81)   -4.0; 0.94 with the default of 1, which is right for these distances
# No warning. krippendorff raises for words that have no order. Of nltk's, alpha and the last alone know distances.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet krippendorff==0.9.0 nltk==3.10.4 irrCAC==0.4.4 scikit-learn==1.9.1 numpy==1.26.4 \
    scipy==1.12.0 pandas==2.3.3
env/bin/python -W error - <<'PYTHON'
from itertools import combinations

import krippendorff
import numpy as np
import pandas as pd
from irrCAC.raw import CAC
from nltk.metrics.agreement import AnnotationTask
from nltk.metrics.distance import interval_distance
from sklearn.metrics import cohen_kappa_score


def task(ratings, distance):
    rows = [(f"person {i}", f"picture {j}", int(ratings[i, j])) for i, j in np.ndindex(ratings.shape)]
    return AnnotationTask(data=rows, distance=distance)


def kappas(found):
    return [getattr(found, name)() for name in ("kappa", "multi_kappa", "pi", "S")]


def by_irrcac(ratings):
    return CAC(pd.DataFrame(ratings.T), weights="quadratic").krippendorff()["est"]["coefficient_value"]


def by_sklearn(ratings):
    return np.mean([cohen_kappa_score(a, b, weights="quadratic") for a, b in combinations(ratings, 2)])


rng = np.random.default_rng(0)
ratings = np.clip(rng.integers(1, 11, 60) + rng.integers(-1, 2, (4, 60)), 1, 10)
guesses = rng.integers(1, 11, (4, 60))
words = ratings.astype(str)
plain = task(ratings, interval_distance)
alphas = [krippendorff.alpha(ratings, level_of_measurement="interval"), plain.alpha(), by_irrcac(ratings)]
print("alpha by krippendorff, nltk, irrCAC", np.round(alphas, 3), "kappa by scikit-learn", by_sklearn(ratings).round(3))
assert np.allclose([*alphas, by_sklearn(ratings)], 0.94, atol=0.005)
others = [krippendorff.alpha(guesses, level_of_measurement="interval"), by_irrcac(guesses), by_sklearn(guesses)]
print("guesses:", np.round(others, 3))
assert np.allclose([*others, task(guesses, interval_distance).alpha()], -0.1, atol=0.01)
print("as words: irrCAC", by_irrcac(words).round(3), "scikit-learn", by_sklearn(words).round(3))
assert np.allclose([by_irrcac(words), by_sklearn(words)], 0.58, atol=0.01)
try:
    krippendorff.alpha(words, level_of_measurement="interval")
except (TypeError, ValueError) as error:
    print("krippendorff:", error)
else:
    raise AssertionError
guessed = kappas(task(guesses, interval_distance))
print("nltk:", np.round(kappas(plain), 3), "guesses", np.round(guessed, 3))
assert np.allclose(kappas(plain), -0.2, atol=0.01) and np.allclose(guessed, -19.9, atol=0.1)
scaled = task(ratings, lambda a, b: (a - b) ** 2 / 81)
guessed = kappas(task(guesses, scaled.distance))
print("nltk, over 81:", np.round(kappas(scaled), 3), "guesses", np.round(guessed, 3))
assert np.allclose(kappas(scaled), 0.985, atol=0.001) and np.allclose(guessed, 0.74, atol=0.005)
weighted = plain.weighted_kappa(max_distance=81), plain.weighted_kappa()
print("nltk, weighted_kappa:", np.round(weighted, 3))
assert abs(weighted[0] + 4) < 0.05 and abs(weighted[1] - 0.94) < 0.005
PYTHON
echo "as described"
