#!/usr/bin/env bash
# Bradley-Terry strengths of methods in a user study: one package stops after two steps, one calls 8 answers to 2 a tie.
#
# Six methods in a row, each of which beats the next by 7 answers to 3: logarithms of strengths fall by 0.85 a step, to
# -4.24, by choix 0.4.1 (ilsr, opt, mm) and evalica 0.4.2 (`bradley_terry`). But
#   crowd-kit 1.4.2, BradleyTerry    to -1.25, the same for an n_iter of 2 and of 100,000: the new vector is compared
#                                    with itself, so that the second step is the last. With tol=0 it goes on, to
#                                    -4.24. Of a 4 : 6 b, b 8 : 2 c, c 8 : 2 d the order is b c a d; by all others,
#                                    and with tol=0, b a c d
#   evalica, eigen                   the larger, the worse: c first of a, b, c, where a beats b beats c by 7 to 3
#   evalica, newman                  two methods, 8 answers to 2: 1.0 and 1.0, whatever `limit` is; eigen and pagerank
#                                    call it even, too; `bradley_terry` 2.0 and 0.5. Of three, newman agrees with that
# No warning.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet choix==0.4.1 evalica==0.4.2 crowd-kit==1.4.2 numpy==1.26.4 scipy==1.12.0 pandas==2.3.3
env/bin/python -W error - <<'PYTHON'
import choix
import evalica
import numpy as np
import pandas as pd
from crowdkit.aggregation import BradleyTerry


def answers(*pairs):
    """Winner and loser of each answer, of pairs of two methods and how often each of them won."""
    return [answer for i, j, wins, losses in pairs for answer in [(i, j)] * wins + [(j, i)] * losses]


def by_evalica(method, names, rows, **options):
    winners, losers = ([names[pair[side]] for pair in rows] for side in (0, 1))
    result = getattr(evalica, method)(winners, losers, [evalica.Winner.X] * len(rows), **options)
    return result.scores[list(names)].to_numpy()


def by_crowdkit(names, rows, **options):
    table = pd.DataFrame([("person", names[i], names[j], names[i]) for i, j in rows])
    table.columns = ["worker", "left", "right", "label"]
    return BradleyTerry(**options).fit_predict(table)[list(names)].to_numpy()


def order(names, strengths):
    return "".join(names[i] for i in np.argsort(-strengths))


line = answers(*((i, i + 1, 7, 3) for i in range(5)))
for name in ("ilsr_pairwise", "opt_pairwise", "mm_pairwise"):
    found = getattr(choix, name)(6, line)
    print(f"choix, {name}: {(found - found[0]).round(2)}")
    assert np.allclose(found - found[0], -np.log(7 / 3) * np.arange(6), atol=0.02)
found = np.log(by_evalica("bradley_terry", "abcdef", line, tolerance=1e-12, limit=100000))
print(f"evalica, bradley_terry: {(found - found[0]).round(2)}")
assert np.allclose(found - found[0], -np.log(7 / 3) * np.arange(6), atol=0.02)
twice = by_crowdkit("abcdef", line, n_iter=2)
found = by_crowdkit("abcdef", line, n_iter=100000, tol=1e-15)
print(f"crowd-kit: {np.log(found / found[0]).round(2)}, steps: two")
assert np.array_equal(twice, found) and abs(np.log(found[5] / found[0]) + 1.25) < 0.01
assert not np.allclose(by_crowdkit("abcdef", line, n_iter=1), found)
found = by_crowdkit("abcdef", line, n_iter=100000, tol=0)
print(f"crowd-kit, tol=0: {np.log(found / found[0]).round(2)}")
assert np.allclose(np.log(found / found[0]), -np.log(7 / 3) * np.arange(6), atol=0.02)

uneven = answers((0, 1, 4, 6), (1, 2, 8, 2), (2, 3, 8, 2))
orders = [
    order("abcd", choix.ilsr_pairwise(4, uneven)),
    order("abcd", by_evalica("bradley_terry", "abcd", uneven)),
    order("abcd", by_crowdkit("abcd", uneven, n_iter=1000, tol=0)),
    order("abcd", by_crowdkit("abcd", uneven, n_iter=1000)),
]
print("uneven: choix, evalica, crowd-kit with tol=0, crowd-kit", orders)
assert orders == ["bacd", "bacd", "bacd", "bcad"]

three = answers((0, 1, 7, 3), (1, 2, 7, 3), (0, 2, 8, 2))
strengths = {name: by_evalica(name, "abc", three) for name in ("counting", "bradley_terry", "newman", "eigen")}
print("three:", {name: found.round(2).tolist() for name, found in strengths.items()})
assert [order("abc", found) for found in strengths.values()] == ["abc", "abc", "abc", "cba"]
assert np.allclose(strengths["newman"], strengths["bradley_terry"], atol=1e-3)

two = answers((0, 1, 8, 2))
strengths = {name: by_evalica(name, "ab", two) for name in ("bradley_terry", "newman", "eigen", "pagerank")}
strengths["newman, limit"] = by_evalica("newman", "ab", two, limit=100000)
print("two:", {name: found.round(2).tolist() for name, found in strengths.items()})
assert np.allclose(strengths.pop("bradley_terry"), [2, 0.5], atol=1e-3)
assert all(np.isclose(*found) for found in strengths.values())
PYTHON
echo "as described"
