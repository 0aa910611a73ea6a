#!/usr/bin/env bash
# pytorch_optimizer 4.1.0: its linear schedule of rates goes on below zero, and "poly" rises to ten times `max_lr`.
#
# Schedules of 100 steps with max_lr=0.05, no warmup; the rate in the first steps, the 51st, the 101st and the 151st:
#                                      1st        2nd       51st      101st     151st
#   linear                             0          0.05      0.0255    0.0005    -0.0245
#   cosine                             0          0.05      0.0258    0.0000    0.0242
#   poly, by default of order 0.5      0          0.05      0.35      0.4975    0.610; of order 2: 490 in the 101st
#   cosine_annealing_with_warmup       0.000001   0.05      0.025     0.045     0.023: begins anew at 0.9 of it
#   rex                                0          0.0498    0.0333    0         0
#   PyTorch 2.13's LinearLR, PolynomialLR                             0         0
# Where training goes on beyond `t_max`, or t_max counts epochs and `step` is called for batches, the optimiser climbs:
# a loss of 0.095 that Adam has taken to 2e-6 after 100 steps is 0.25 after 150. No warning; given -0.0245 as its
# rate, Adam raises. The formula of "poly" is in its docstring; poly in papers is one that falls, as PyTorch's.
#
# All of these give each group of parameters the same rate, which their docstring says: of 0.00016 for places and 0.05
# for opacities, as trainers of Gaussians have, both become 0.05. warmup_stable_decay and chebyshev keep their ratio.
# Four optimisers do so, too: of rates that are 1 to 100 the steps are equal by A2Grad, ApolloDQN, Nero and AdaFactor,
# and 1 to 100 by Adam, AdamW, Lion, Ranger, LaProp and SGDW.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 pytorch_optimizer==4.1.0
env/bin/python -W error::UserWarning - <<'PYTHON'
import inspect

import torch
from pytorch_optimizer import load_lr_scheduler, load_optimizer

LINEAR = {"t_max": 100, "max_lr": 0.05}


def rates(name, options, kind=None):
    groups = [{"params": [torch.nn.Parameter(torch.ones(1))], "lr": rate} for rate in (0.00016, 0.05)]
    optimizer = torch.optim.Adam(groups)
    schedule, found = (kind or load_lr_scheduler(name))(optimizer, **options), []
    for _ in range(151):
        found.append([group["lr"] for group in optimizer.param_groups])
        optimizer.step()
        schedule.step()
    return found


for name, options, kind, expected in (
    ("linear", LINEAR, None, (0, 0.05, 0.0255, 0.0005, -0.0245)),
    ("cosine", LINEAR, None, (0, 0.05, 0.0258, 0.0000, 0.0242)),
    ("poly", LINEAR, None, (0, 0.05, 0.35, 0.4975, 0.6103)),
    ("poly", LINEAR | {"poly_order": 2}, None, (0, 0.05, 120.05, 490.05, 1110.05)),
    ("cosine_annealing_with_warmup", {"first_cycle_steps": 100, "max_lr": 0.05}, None,
     (1e-6, 0.05, 0.025, 0.045, 0.0225)),
    ("rex", {"total_steps": 100, "max_lr": 0.05}, None, (0, 0.0498, 0.0333, 0, 0)),
    ("chebyshev", {"num_epochs": 128}, None, None),
    ("warmup_stable_decay", {"num_warmup_steps": 0, "num_stable_steps": 20, "num_decay_steps": 80}, None, None),
    ("LinearLR", {"start_factor": 1, "end_factor": 0, "total_iters": 100}, torch.optim.lr_scheduler.LinearLR,
     (0.05, 0.0495, 0.025, 0, 0)),
    ("PolynomialLR", {"power": 0.5, "total_iters": 100}, torch.optim.lr_scheduler.PolynomialLR,
     (0.05, 0.04975, 0.0354, 0, 0)),
):
    path = rates(name, options, kind)
    seen = [path[step][1] for step in (0, 1, 50, 100, 150)]
    print(f"{name:28}", *(f"{rate:.6g}" for rate in seen))
    assert expected is None or all(abs(a - b) < 1e-4 * max(1, abs(b)) for a, b in zip(seen, expected)), name
    own = kind is not None or expected is None
    assert all(abs(second - first * (312.5 if own else 1)) < 1e-9 for first, second in path), name

torch.manual_seed(0)
target, weights = 0.3 * torch.randn(100), torch.nn.Parameter(torch.zeros(100))
optimizer, losses = torch.optim.Adam([weights]), []
schedule = load_lr_scheduler("linear")(optimizer, **LINEAR)
for _ in range(151):
    optimizer.zero_grad()
    loss = (weights - target).square().mean()
    loss.backward()
    losses.append(loss.item())
    optimizer.step()
    schedule.step()
print(f"loss at the beginning {losses[0]:.3g}, after 100 steps {losses[100]:.3g}, after 150 {losses[150]:.3g}")
assert 0.05 < losses[0] < 0.2 and losses[100] < 1e-5 and losses[150] > 0.2
try:
    torch.optim.Adam([weights], lr=-0.0245)
except ValueError as error:
    print(error)
else:
    raise AssertionError("a negative rate was taken")


def ratio(name):
    kind = load_optimizer(name)
    places = [torch.nn.Parameter(torch.ones(8, 8)) for _ in range(2)]
    groups = [{"params": [place], "lr": rate} for place, rate in zip(places, (1e-4, 1e-2))]
    optimizer = kind(groups, **{"weight_decay": 0.0} if "weight_decay" in inspect.signature(kind).parameters else {})
    slope = torch.randn(8, 8, generator=torch.Generator().manual_seed(1))
    for _ in range(20):
        optimizer.zero_grad()
        sum((place * slope).sum() for place in places).backward()
        optimizer.step()
    return float((places[1] - 1).norm().detach() / (places[0] - 1).norm().detach())


for names, low, high in ((("a2grad", "apollodqn", "nero", "adafactor"), 0.999, 1.001),
                         (("adam", "adamw", "lion", "ranger", "laprop", "sgdw"), 99, 101)):
    for name in names:
        print(f"{name:10} {ratio(name):.3f}")
        assert low < ratio(name) < high, name
PYTHON
echo "as described"
