#!/usr/bin/env bash
# Methods that were never compared, as of two user studies put together: six rankings of six methods, and few warnings.
#
# a, b, c were compared with one another, 7 answers to 3, and d, e, f, 9 to 1; nobody compared across. How strong d is
# beside a cannot be known. Seen, the rows as they are and turned round:
#   evalica 0.4.2, bradley_terry      d e a b c f, and d a b e c f: its answer depends on the order of the rows
#                  eigen              a, b, c above 0, d, e, f at 0 (and c before a)
#   choix 0.4.1, opt_pairwise         each group centred at 0: b and e alike
#                mm_pairwise          a mean of 0.25 for the first group, of -0.25 for the second
#                rank_centrality      NaN for the first group, infinite for the second, and a RuntimeWarning
#                lsr_, ilsr_pairwise  ValueError; with alpha=0.01 an answer
#   crowd-kit 1.4.2, BradleyTerry     d a b e c f
#   statsmodels 0.15.0, GLM           as choix's first, and a SingularMatrixWarning
# With one pair across, evalica's two agree. Look whether comparisons connect all methods before they are ranked.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet choix==0.4.1 evalica==0.4.2 crowd-kit==1.4.2 statsmodels==0.15.0 numpy==1.26.4 \
    scipy==1.12.0 pandas==2.3.3
env/bin/python - <<'PYTHON'
import warnings

import choix
import evalica
import numpy as np
import pandas as pd
import statsmodels.api as sm
from crowdkit.aggregation import BradleyTerry

names = "abcdef"
answers = []  # winner and loser
for first, second, wins in ((0, 1, 7), (1, 2, 7), (0, 2, 7), (3, 4, 9), (4, 5, 9), (3, 5, 9)):
    answers += [(first, second)] * wins + [(second, first)] * (10 - wins)
across = [(0, 4)] * 6 + [(4, 0)] * 4


def by_evalica(method, answers):
    winners, losers = ([names[pair[side]] for pair in answers] for side in (0, 1))
    return getattr(evalica, method)(winners, losers, [evalica.Winner.X] * len(answers)).scores[list(names)]


def order(scores):
    return "".join(scores.sort_values(ascending=False).index)


def quietly(function, *given, **options):
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = function(*given, **options)
    return result, {warning.category.__name__ for warning in caught}


both = [quietly(by_evalica, "bradley_terry", rows) for rows in (answers, answers[::-1])]
print("evalica, bradley_terry:", [order(scores) for scores, _ in both])
assert [order(scores) for scores, _ in both] == ["deabcf", "dabecf"] and not (both[0][1] | both[1][1])
connected = [order(by_evalica("bradley_terry", rows)) for rows in (answers + across, (answers + across)[::-1])]
print("evalica, bradley_terry, one pair across:", connected)
assert connected == ["daebcf"] * 2
eigen, caught = quietly(by_evalica, "eigen", answers)
print("evalica, eigen:", eigen.round(2).to_dict())
assert not caught and eigen["c"] > eigen["b"] > eigen["a"] > 0.4 and eigen[list("def")].max() < 1e-3

opt, caught = quietly(choix.opt_pairwise, 6, answers)
print("choix, opt_pairwise:", opt.round(2))
assert not caught and abs(opt[:3].sum()) < 1e-3 and abs(opt[3:].sum()) < 1e-3
mm, caught = quietly(choix.mm_pairwise, 6, answers)
print("choix, mm_pairwise:", mm.round(2))
assert not caught and 0.2 < mm[:3].mean() < 0.3 and -0.3 < mm[3:].mean() < -0.2
central, caught = quietly(choix.rank_centrality, 6, answers)
print("choix, rank_centrality:", central, caught)
assert caught == {"RuntimeWarning"} and np.isnan(central[:3]).all() and np.isinf(central[3:]).all()
for name in ("lsr_pairwise", "ilsr_pairwise"):
    try:
        getattr(choix, name)(6, answers)
    except ValueError as error:
        print(f"choix, {name}: {str(error)[:50]}; alpha=0.01: {getattr(choix, name)(6, answers, alpha=0.01).round(2)}")
    else:
        raise AssertionError(name)

table = pd.DataFrame([("person", names[i], names[j], names[i]) for i, j in answers])
table.columns = ["worker", "left", "right", "label"]
crowd, caught = quietly(lambda: BradleyTerry(100).fit_predict(table))
print("crowd-kit:", order(crowd))
assert not caught and order(crowd) == "dabecf"

sides = np.zeros((len(answers), 6))
for row, (winner, loser) in enumerate(answers):
    sides[row, winner], sides[row, loser] = 1, -1
turned = np.arange(len(answers)) % 2 == 0  # half of the rows name the loser first
sides[turned] *= -1
fitted, caught = quietly(lambda: sm.GLM((~turned).astype(float), sides, family=sm.families.Binomial()).fit())
print("statsmodels:", fitted.params.round(2), caught)
assert any("SingularMatrix" in name for name in caught) and np.allclose(fitted.params, opt, atol=0.01)
PYTHON
echo "as described"
