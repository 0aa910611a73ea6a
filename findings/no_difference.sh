#!/usr/bin/env bash
# crowd-kit 1.4.2: a vote that is even has a winner, and the answer "no difference" is one more method.
#
# Answers of a user study that compares methods in pairs. Four people, two of whom prefer each, in all of six pictures:
#   MajorityVote, DawidSkene    the method that the table names first wins all six; rows turned round, the other does
# 60 answers among three methods, a third of them "no difference":
#   BradleyTerry                NaN for all, a RuntimeWarning of a division; "no difference" has a row
#   NoisyBradleyTerry           a score of "no difference" between those of the methods, which change; no word
# Left out beforehand, all is well.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet crowd-kit==1.4.2 numpy==2.4.6 pandas==3.0.3
env/bin/python - <<'PYTHON'
import warnings

import numpy as np
import pandas as pd
from crowdkit.aggregation import BradleyTerry, DawidSkene, MajorityVote, NoisyBradleyTerry

warnings.filterwarnings("ignore", category=pd.errors.PandasFutureWarning)
warnings.filterwarnings("ignore", category=DeprecationWarning)
even = pd.DataFrame(
    [{"task": task, "worker": worker, "label": ("new", "old")[worker % 2]} for task in range(6) for worker in range(4)]
)
for votes, winner in ((even, "new"), (even[::-1], "old")):
    found = [set(method.fit_predict(votes)) for method in (MajorityVote(), DawidSkene(n_iter=20))]
    print(f"two votes each, first row {votes.label.iloc[0]!r}: won by {found}")
    assert found == [{winner}, {winner}]

random = np.random.default_rng(0)
rows = [
    {"worker": worker, "left": left, "right": right, "label": right if random.random() < 0.75 else left}
    for worker in range(20)
    for left, right in (("a", "b"), ("a", "c"), ("b", "c"))
]
answers = pd.DataFrame(rows)
undecided = answers.assign(label=answers.label.where(random.random(60) > 1 / 3, "no difference"))
for name, method in {"BradleyTerry": BradleyTerry, "NoisyBradleyTerry": NoisyBradleyTerry}.items():
    scores = []
    for table in (answers, undecided, undecided[undecided.label != "no difference"]):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            model = method(n_iter=100) if method is BradleyTerry else method(n_iter=100, random_state=0)
            scores.append(model.fit_predict(table))
        warned = any(warning.category is RuntimeWarning for warning in caught)
        print(f"{name}: {scores[-1].round(3).to_dict()}{', a warning' * warned}")
    assert list(scores[0].index) == list(scores[2].index) == ["a", "b", "c"]
    assert scores[0].is_monotonic_increasing and scores[2].is_monotonic_increasing
    assert "no difference" in scores[1].index
    if method is BradleyTerry:
        assert scores[1].isna().all()
    else:
        assert scores[1]["a"] < scores[1]["no difference"] < scores[1]["c"]
PYTHON
echo "as described"
