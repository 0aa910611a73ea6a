#!/usr/bin/env bash
# autorank 1.3.0: where one answer is missing, its report calls a method significantly better, with "p=nan".
#
# 24 people give methods 3, 4 or 5 at random; 20 photographs have scores from one distribution. One number of all is
# missing. What `create_report` writes, for alpha = 0.05:
#                                     complete                     one number missing
#   two methods, ratings              failed to reject, p=0.848    reject (p=nan), a significantly larger, "large"
#   three methods, ratings            failed to reject, p=0.804    reject (p=nan), a significant difference
#   two methods, scores               failed to reject, p=0.987    reject (p=nan), b significantly larger
#   three methods, scores             failed to reject, p=0.736    reject (p=nan), a significant difference
# No error. Another thing, where nothing is missing: if more than half of the people give each of two methods the same
# rating, their effect is 0 / 0, and the table of results calls it "large", although the medians are equal, also for a
# method against itself. NumPy warns of a division there. Guessed: an error, or p-values without that row. Leave out
# rows with a missing number beforehand (`data.dropna()`), and take no "large" whose effect size is NaN.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet autorank==1.3.0 baycomp==1.0.3 pandas==3.1.1 scipy==1.17.1 statsmodels==0.15.0 \
    scikit-learn==1.9.1 matplotlib==3.11.2 jinja2==3.1.6 numpy==2.4.6
env/bin/python -W error::UserWarning -W ignore::RuntimeWarning - <<'PYTHON'
import contextlib
import io

import numpy as np
import pandas as pd
from autorank import autorank, create_report

people = np.random.default_rng(3)
ratings = pd.DataFrame({name: people.choice([3.0, 4, 5], 24, p=[0.2, 0.6, 0.2]) for name in "abc"})
photographs = np.random.default_rng(0)
scores = pd.DataFrame(photographs.normal(30, 1, (20, 3)), columns=list("abc"))


def report(data):
    with contextlib.redirect_stdout(io.StringIO()):
        result = autorank(data, alpha=0.05, verbose=False)
    with contextlib.redirect_stdout(io.StringIO()) as text:
        create_report(result)
    said = [line for line in text.getvalue().splitlines() if "(p=nan)" in line or "failed to reject the null" in line]
    return result, said[-1]


for name, whole in (
    ("two methods, ratings", ratings[["a", "b"]]),
    ("three methods, ratings", ratings),
    ("two methods, scores", scores[["a", "b"]]),
    ("three methods, scores", scores),
):
    result, said = report(whole)
    print(f"{name}, complete: p = {result.pvalue:.3f}: {said[:70]} ... {said[said.index('Therefore'):]}")
    assert result.pvalue > 0.05 and said.startswith("We failed to reject")
    assert "no statistically significant difference" in said
    missing = whole.copy()
    missing.iloc[2, 0] = np.nan
    result, said = report(missing)
    print(f"   one missing: {said[:70]} ... {said[said.index('Therefore'):]}")
    assert np.isnan(result.pvalue) and said.startswith("We reject the null hypothesis (p=nan)")
    assert "significantly larger" in said or "there is a statistically significant difference" in said
    result, said = report(missing.dropna())
    assert result.pvalue > 0.05 and said.startswith("We failed to reject")

table = report(ratings)[0].rankdf[["median", "mad", "effect_size", "magnitude"]]
print(table.to_string())
assert (table["median"] == 4).all() and table["effect_size"].isna().all() and (table["magnitude"] == "large").all()
PYTHON
echo "as described"
