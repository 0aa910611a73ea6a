#!/usr/bin/env bash
# optuna 5.0.0: a stored study that is opened again with another direction keeps the old one; its best is the worst.
#
# `create_study(study_name="scene", storage=..., load_if_exists=True)`, as scripts that go on have it. Opened first
# without a direction, then as direction="maximize", for the value is a PSNR:
#   direction                                 still MINIMIZE
#   best_value of 21, 27, 24, 30, 18 dB       18
#   20 further trials by TPE                  go where PSNR is low: a mean of 20.8 dB, 27.8 by a study that is new
#   range of a rate, 0.1 to 1 first, then 1 to 10: best_params may have a rate outside of what is asked for now
# The same of `directions=["maximize", "minimize"]` given the other way round. No exception, no warning, and no word by
# optuna's own log but "Using an existing study ... instead of creating a new one".
# Compare `study.direction` with what was meant, or have its name say it.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet optuna==5.0.0 numpy==2.4.6
env/bin/python -W error::UserWarning - <<'PYTHON'
import logging

import numpy as np
import optuna

said = []
handler = logging.Handler()
handler.emit = lambda record: said.append(record.getMessage())
optuna.logging.disable_default_handler()
optuna.logging.get_logger("optuna").addHandler(handler)


def opened(name, **options):
    sampler = optuna.samplers.TPESampler(seed=0)
    return optuna.create_study(
        study_name=name, storage="sqlite:///studies.db", load_if_exists=True, sampler=sampler, **options
    )


def decibels(trial):
    return 18 + 12 * trial.suggest_float("weight", 0, 1)


first = opened("scene")
for value in (21, 27, 24, 30, 18):
    first.add_trial(
        optuna.create_trial(
            params={"weight": (value - 18) / 12},
            distributions={"weight": optuna.distributions.FloatDistribution(0, 1)},
            value=value,
        )
    )
said.clear()
again = opened("scene", direction="maximize")
print(again.direction.name, again.best_value, said)
assert again.direction.name == "MINIMIZE" and again.best_value == 18 and len(said) == 1 and "existing study" in said[0]

fresh = opened("other", direction="maximize")
fresh.add_trials(again.trials)
means = []
for study in (again, fresh):
    study.optimize(decibels, n_trials=20)
    means.append(np.mean([trial.value for trial in study.trials[-20:]]))
print("mean of 20 further trials:", np.round(means, 1))
assert means[0] < 22 and means[1] > 26

two = opened("two", directions=["minimize", "maximize"])
turned = opened("two", directions=["maximize", "minimize"])
print([direction.name for direction in turned.directions])
assert turned.directions == two.directions

rates = opened("rates", direction="maximize")
rates.optimize(lambda trial: -trial.suggest_float("rate", 0.1, 1), n_trials=5)
moved = opened("rates", direction="maximize")
moved.optimize(lambda trial: -trial.suggest_float("rate", 1, 10), n_trials=5)
print("rate asked for from 1 to 10, best:", moved.best_params)
assert moved.best_params["rate"] < 1
PYTHON
echo "as described"
