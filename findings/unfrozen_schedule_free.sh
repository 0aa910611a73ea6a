#!/usr/bin/env bash
# schedulefree 1.4.1: parameters added during training, as of unfrozen layers, are evaluated without their average.
#
# A linear regression with noise, 2000 steps; its matrix joins the optimiser at step 200 by `add_param_group`. The mean
# square error of the matrix at the end, after `optimizer.eval()`, of 3 seeds, in units of 0.0001:
#                                            AdamW      SGD       RAdam
#   in the optimiser from the beginning      1.0        1.0       1.6
#   added while training                     4.8        3.0       3.8
#   added, then `optimizer.train()`          1.1        1.1       1.7
# A new group begins in the mode "eval", the others are in "train", and `step` looks at the first group only. At the
# next `eval()` the new one is left as it is: the weights where gradients are taken, which no schedule has settled. The
# `train()` after it then moves them once more, as if they had been averaged. Where validation ends with `train()`, the
# first score after unfreezing is wrong, and later ones are right; without one, the saved model is. No warning.
# Call `optimizer.train()` after `add_param_group`.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 schedulefree==1.4.1 numpy==2.4.6 setuptools==80.9.0
env/bin/python -W error - <<'PYTHON'
import numpy as np
import torch
from schedulefree import AdamWScheduleFree, RAdamScheduleFree, SGDScheduleFree
from torch.nn import Parameter

torch.set_num_threads(1)
torch.set_default_dtype(torch.float64)


def trained(method, rate, how, seed, steps=2000):
    generator = torch.Generator().manual_seed(seed)
    truth = torch.randn(8, 8, generator=generator)
    bias, matrix = Parameter(torch.zeros(8)), Parameter(torch.eye(8))
    matrix.requires_grad_(how == "beginning")
    optimizer = method([bias, matrix] if how == "beginning" else [bias], lr=rate)
    optimizer.train()
    for step in range(steps):
        if step == 200 and how != "beginning":
            matrix.requires_grad_(True)
            optimizer.add_param_group({"params": [matrix]})
            assert [group["train_mode"] for group in optimizer.param_groups] == [True, False]
            if how == "added, train()":
                optimizer.train()
        inputs = torch.randn(8, 8, generator=generator)
        outputs = inputs @ truth + 0.5 * torch.randn(8, 8, generator=generator)
        optimizer.zero_grad()
        (inputs @ matrix + bias - outputs).square().mean().backward()
        optimizer.step()
    before = matrix.detach().clone()
    optimizer.eval()
    evaluated = matrix.detach().clone()
    optimizer.train()
    assert torch.equal(evaluated, before) == (how == "added")
    assert torch.allclose(matrix.detach(), before, rtol=0, atol=1e-12) == (how != "added")
    return 1e4 * float((evaluated - truth).square().mean())


for method, rate, expected in (
    (AdamWScheduleFree, 0.05, (1.0, 4.8, 1.1)),
    (SGDScheduleFree, 0.5, (1.0, 3.0, 1.1)),
    (RAdamScheduleFree, 0.05, (1.6, 3.8, 1.7)),
):
    found = [np.mean([trained(method, rate, how, seed) for seed in range(3)])
             for how in ("beginning", "added", "added, train()")]
    print(f"{method.__name__:18} from the beginning {found[0]:.2f}, added {found[1]:.2f}, with train() {found[2]:.2f}")
    assert np.allclose(found, expected, rtol=0.3) and found[1] > 1.6 * max(found[0], found[2])
PYTHON
echo "as described"
