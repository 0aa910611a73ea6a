#!/usr/bin/env bash
# pytorch_optimizer 4.1.0: one step of SRMM or FTRL, of whatever rate, and what was trained before is forgotten.
#
# A layer that is fitted exactly (all gradients 0), a rate of 1e-6, no decay of weights; after one step:
#                                             weight of 1 becomes       share of the fit that is lost
#   AdamW, RAdam, Ranger, Lion, SGDW, LaProp  1                         0
#   SRMM                                      0.7071                    0.086
#   FTRL                                      0                         1
#   Nero                                      0, by its constraints     1 (of rows of equal weights)
#   Gravity                                   1, and noise of 0.0067    0.00005, at every rate
# SRMM begins its mean of the weights at 0 and gives it (1 + 1)^-0.5 of them; FTRL computes weights from a sum that
# begins at 0, as it was published. So Gaussians that a batch does not see, and networks taken further, change at once.
#
# Ranger steps the wrong way five times, by the whole rate, before its rectification begins: a weight of 1 whose
# gradient is always 1, at a rate of 0.1, is 1.1, 1.2, 1.3, 1.4, 1.5, and 1.25 after its first lookahead. RAdam stays
# at 1 meanwhile; with `degenerated_to_sgd=True` Ranger falls. Trained further for a few steps, a network gets worse.
# Ranger's sign was reported publicly once, and closed. No warning in either case.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 pytorch_optimizer==4.1.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import inspect

import torch
from pytorch_optimizer import load_optimizer

DATA = torch.randn(256, 8, generator=torch.Generator().manual_seed(0))


def make(name, parameters, rate, **options):
    kind = load_optimizer(name)
    if "weight_decay" in inspect.signature(kind.__init__).parameters:
        options["weight_decay"] = 0.0
    return kind(parameters, lr=rate, **options)


def after_one_step(name, rate):
    """A weight's mean and spread, and how much of the variance is no longer explained."""
    torch.manual_seed(0)
    weight = torch.nn.Parameter(torch.ones(8, 8))
    target = DATA @ weight.detach()
    optimizer = make(name, [weight], rate)
    ((DATA @ weight - target) ** 2).mean().backward()
    assert weight.grad.abs().max() == 0
    optimizer.step()
    values = weight.detach()
    lost = ((DATA @ values - target) ** 2).mean() / (target ** 2).mean()
    return float(values.mean()), float(values.std()), float(lost)


def path(name, steps=6, **options):
    weight = torch.nn.Parameter(torch.ones(1))
    optimizer, places = make(name, [weight], 0.1, **options), []
    for _ in range(steps):
        optimizer.zero_grad()
        weight.sum().backward()
        optimizer.step()
        places.append(weight.item())
    return places


found = {}
for name in ("adamw", "radam", "ranger", "lion", "sgdw", "laprop", "srmm", "ftrl", "nero", "gravity"):
    for rate in (1e-6, 1e-3):
        found[name, rate] = after_one_step(name, rate)
        print(f"{name:8} {rate:g}: weight {found[name, rate][0]:.4f}, spread {found[name, rate][1]:.4f}, "
              f"lost {found[name, rate][2]:.4g}")
for rate in (1e-6, 1e-3):
    for name in ("adamw", "radam", "ranger", "lion", "sgdw", "laprop"):
        mean, spread, lost = found[name, rate]
        assert abs(mean - 1) < 1e-6 and spread < 1e-6 and lost < 1e-10, name
    assert abs(found["srmm", rate][0] - 0.5 ** 0.5) < 1e-4 and abs(found["srmm", rate][2] - 0.0858) < 1e-3
    assert found["ftrl", rate][0] == 0 and abs(found["ftrl", rate][2] - 1) < 1e-6
    assert abs(found["nero", rate][0]) < 1e-4 and abs(found["nero", rate][2] - 1) < 1e-3
    assert 0.004 < found["gravity", rate][1] < 0.01 and 1e-5 < found["gravity", rate][2] < 2e-4

ranger, radam, other = path("ranger"), path("radam"), path("ranger", degenerated_to_sgd=True)
for name, places in (("Ranger", ranger), ("RAdam", radam), ("Ranger, degenerated_to_sgd", other)):
    print(f"{name:27}", *(f"{place:.4f}" for place in places))
assert all(abs(place - 1 - 0.1 * step) < 1e-5 for step, place in enumerate(ranger[:5], 1))
assert 1.2 < ranger[5] < 1.3 and all(place == 1 for place in radam[:5])
assert all(abs(place - 1 + 0.1 * step) < 1e-5 for step, place in enumerate(other[:5], 1))
PYTHON
echo "as described"
