#!/usr/bin/env bash
# Whole numbers from 1 to 4 in random searches: with four packages of six the ends come half as often as the middle.
#
# As for a degree of harmonics, a layer or a number of styles; 4000 draws before any result is known. Guessed: evenly by
# all but nevergrad and hyperopt's quniform.
#                                                                       1       2       3       4
#   optuna 5.0.0 suggest_int, ConfigSpace 1.2.2                         1/4     1/4     1/4     1/4
#   hyperopt 0.3.0 randint(1, 5); flaml 2.8.0 qrandint, randint         1/4     1/4     1/4     1/4
#   scikit-optimize 0.10.2 Integer(1, 4), "RF" and "ET"                 1/4     1/4     1/4     1/4
#                   with "GP", the default, and gp_minimize             1/6     1/3     1/3     1/6
#   hyperopt uniformint(1, 4); flaml quniform(1, 4, 1)                  1/6     1/3     1/3     1/6
#   nevergrad 1.0.12 Scalar(lower=1, upper=4).set_integer_casting()     1/6     1/3     1/3     1/6
# scikit-optimize's documentation says that they come evenly. The latter round a number between 1 and 4. Of two values,
# 0 and 1, both come as often. The first and the last of a range are what a search is often about; of 20 trials they get
# 7 in place of 10. Name the values, as a choice, or use randint.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet optuna==5.0.0 ConfigSpace==1.2.2 hyperopt==0.3.0 flaml==2.8.0 scikit-optimize==0.10.2 \
  scikit-learn==1.9.1 nevergrad==1.0.12 setuptools==65.5.0 numpy==2.0.2
env/bin/python -W ignore - <<'PYTHON'
import nevergrad as ng
import numpy as np
import optuna
from ConfigSpace import UniformIntegerHyperparameter
from flaml import tune
from hyperopt import hp
from hyperopt.pyll.stochastic import sample
from skopt import Optimizer, gp_minimize
from skopt.space import Integer, Real

DRAWS = 4000
optuna.logging.set_verbosity(optuna.logging.ERROR)
np.random.seed(0)
generator = np.random.default_rng(0)


def by_optuna():
    study = optuna.create_study(sampler=optuna.samplers.RandomSampler(seed=0))
    return [study.ask().suggest_int("n", 1, 4) for _ in range(DRAWS)]


def by_nevergrad():
    number = ng.p.Scalar(lower=1, upper=4).set_integer_casting()
    search = ng.optimizers.RandomSearch(number, budget=DRAWS)
    search.parametrization.random_state.seed(0)
    return [search.ask().value for _ in range(DRAWS)]


def by_hyperopt(space):
    return [sample(space, rng=generator) for _ in range(DRAWS)]


def by_optimizer(estimator):
    search = Optimizer([Integer(1, 4), Real(0, 1)], estimator, n_initial_points=DRAWS, random_state=0)
    return [search.ask()[0] for _ in range(DRAWS)]


def by_gp_minimize():
    space = [Integer(1, 4), Real(0.0, 1.0)]
    found = gp_minimize(lambda point: 0.0, space, n_calls=400, n_initial_points=400, random_state=0)
    return [point[0] for point in found.x_iters]


numbers = UniformIntegerHyperparameter("n", 1, 4)
EVEN = {
    "optuna": by_optuna, "ConfigSpace": lambda: numbers.sample_value(DRAWS, seed=np.random.RandomState(0)),
    "hyperopt randint": lambda: by_hyperopt(hp.randint("n", 1, 5)),
    "flaml randint": lambda: [tune.randint(1, 5).sample() for _ in range(DRAWS)],
    "flaml qrandint": lambda: [tune.qrandint(1, 4, 1).sample() for _ in range(DRAWS)],
    "skopt RF": lambda: by_optimizer("RF"), "skopt ET": lambda: by_optimizer("ET"),
}
HALVED = {
    "skopt GP": lambda: by_optimizer("GP"),
    "skopt gp_minimize": by_gp_minimize,
    "hyperopt uniformint": lambda: by_hyperopt(hp.uniformint("n", 1, 4)),
    "flaml quniform": lambda: [tune.quniform(1, 4, 1).sample() for _ in range(DRAWS)],
    "nevergrad": by_nevergrad,
}
for methods, ends in ((EVEN, 1 / 4), (HALVED, 1 / 6)):
    for name, method in methods.items():
        drawn = np.asarray(method(), float)
        shares = np.array([np.mean(drawn == number) for number in (1, 2, 3, 4)])
        print(f"{name}: {np.round(shares, 3)}")
        assert np.isclose(shares.sum(), 1)
        assert np.allclose(shares, [ends, 0.5 - ends, 0.5 - ends, ends], atol=0.02 if len(drawn) == DRAWS else 0.06)
PYTHON
echo "as described"
