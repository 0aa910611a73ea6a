#!/usr/bin/env bash
# scikit-posthocs 0.17.1: what belongs to one person is not looked up, and a second picture a person empties the table.
#
# 1. `posthoc_wilcoxon` tests pairs, and takes no column of persons: the n-th row of a method is paired with the n-th of
#    another. Rows of a study come in the order of answers. Seen: 12 people, each of whom scores b above a: p = 0.001;
#    the same rows shuffled: 0.424. `sort=True` sorts by method alone and does not help. No warning.
# 2. `posthoc_{nemenyi,conover,siegel}_friedman` with two scores a person and method (two pictures) return a table of
#    0 x 0, in silence but for conover's divisions by zero; `posthoc_durbin` answers. Without `block_id_col` all of them
#    refuse any long table, saying that blocks are duplicated, for one score a person, too.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet scikit-posthocs==0.17.1 pandas==3.1.1 scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import warnings

import numpy as np
import pandas as pd
import scikit_posthocs as posthocs

generator = np.random.default_rng(1)
usual = 2 * generator.normal(size=12)
rows = [
    (f"p{person:02d}", method, usual[person] + 0.5 * better + 0.2 * generator.normal())
    for person in range(12)
    for better, method in enumerate("abc")
]
table = pd.DataFrame(rows, columns=["person", "method", "score"])
shuffled = table.sample(frac=1, random_state=0)


def wilcoxon(scores, **options):
    with warnings.catch_warnings(action="error"):
        return posthocs.posthoc_wilcoxon(scores, val_col="score", group_col="method", **options).loc["a", "b"]


p, mixed, again = wilcoxon(table), wilcoxon(shuffled), wilcoxon(shuffled, sort=True)
print(f"p of a and b: {p:.4f}; shuffled {mixed:.4f}; shuffled and sort=True {again:.4f}")
assert p < 0.005 and mixed > 0.2 and again == mixed

names = {"melted": True, "y_col": "score", "group_col": "method", "block_col": "person"}
twice = pd.concat([table, table.assign(score=table["score"] + 0.1 * generator.normal(size=len(table)))])
for test in ("nemenyi_friedman", "conover_friedman", "siegel_friedman", "durbin"):
    run = getattr(posthocs, f"posthoc_{test}")
    with warnings.catch_warnings(record=True, action="always") as told:
        one, two = (run(scores, **names, block_id_col="person") for scores in (table, twice))
    assert {one.category for one in told if "deprecated" not in str(one.message)} == (
        {RuntimeWarning} if test == "conover_friedman" else set()
    )
    print(f"{test}: {one.shape} with one score each, {two.shape} with two")
    assert one.shape == (3, 3) and two.shape == ((3, 3) if test == "durbin" else (0, 0))
    try:
        run(table, **names)
    except ValueError as error:
        assert "duplicated" in str(error)
    else:
        raise AssertionError(test)
PYTHON
echo "as described"
