#!/usr/bin/env bash
# torchmetrics 1.9.0, `BootStrapper`: its interval depends on how an evaluation was cut into updates.
#
# The wrapper resamples within each update, not over all that it has seen. 64 values of an evaluation, whose mean has a
# standard error of 0.125, by 400 bootstraps:
#   sampling_strategy="multinomial", one update of 64: 0.12     64 updates of one: 0.00 (a row drawn from one is itself)
#   sampling_strategy="poisson" (default), one of 64: 0.12      64 updates of one: 0.12
# Nothing is said. Evaluations of this field update scene by scene or view by view, so that "multinomial" reports a
# score without error. With the default the interval is right, but takes views of one scene for independent.
set -euo pipefail
cd "$(mktemp -d)"
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 setuptools==80.9.0
env/bin/python - <<'PYTHON'
import torch
from torchmetrics import MeanMetric
from torchmetrics.wrappers import BootStrapper

values = torch.randn(64, generator=torch.Generator().manual_seed(0))
values = (values - values.mean()) / values.std()


def error(strategy, size):
    torch.manual_seed(1)
    metric = BootStrapper(MeanMetric(), num_bootstraps=400, sampling_strategy=strategy)
    for part in values.split(size):
        metric.update(part)
    return metric.compute()["std"].item()


seen = {(strategy, size): error(strategy, size) for strategy in ("multinomial", "poisson") for size in (64, 1)}
for (strategy, size), value in seen.items():
    print(f"{strategy:12} updates of {size:2}: standard error {value:.3f} (of the mean: {1 / 8:.3f})")
assert seen["multinomial", 1] == 0 and all(abs(value - 1 / 8) < 0.02 for key, value in seen.items() if key != ("multinomial", 1))
PYTHON
