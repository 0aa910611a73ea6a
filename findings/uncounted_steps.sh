#!/usr/bin/env bash
# Steps of fused optimisers are not counted, PyTorch 2.13.0: what is kept by a tensor's `_version` is stale after them.
#
# One step of a small network, and by how much the version counter of its first weight rises:
#   Adam, AdamW, SGD, Adagrad, by default and with foreach=True       1 or 2
#   the same four with fused=True                                     0
#   madgrad 1.3; RAdam, AdaBound and Lamb of torch-optimizer 0.3.0    0
#   lion-pytorch 0.2.5, schedulefree 1.4.1, AdaBelief of pytorch_optimizer 4.1.0    1 or 2
# Features that are computed anew where that counter has risen, as a cache of a metric's network keeps them, are those
# of the old weights after Adam with `fused=True`, off by one and a half times their size here; by default they are
# right. Fused kernels do not raise the counter, nor do optimisers that write to `.data`. No warning. Key such a cache
# by a hash of the values, keep nothing of weights that learn, or raise the counter in a hook of the optimiser, as by
# `optimizer.register_step_post_hook(lambda *_: torch.autograd.graph.increment_version(parameters))`.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 lion-pytorch==0.2.5 schedulefree==1.4.1 madgrad==1.3 \
  pytorch_optimizer==4.1.0 torch-optimizer==0.3.0
cat > steps.py <<'PYTHON'
import lion_pytorch
import madgrad
import pytorch_optimizer
import schedulefree
import torch
import torch_optimizer
from torch.autograd.graph import increment_version

torch.manual_seed(0)
network = torch.nn.Sequential(torch.nn.Linear(8, 16), torch.nn.Tanh(), torch.nn.Linear(16, 4))
start = {name: value.clone() for name, value in network.state_dict().items()}
pictures = torch.randn(32, 8)
kept = {}


@torch.no_grad()
def features():
    """Of the pictures, computed anew where a weight's version has risen."""
    key = tuple(parameter._version for parameter in network.parameters())
    if key not in kept:
        kept.clear()
        kept[key] = network(pictures)
    return kept[key]


def stepped(make):
    """By how much a step raises the counter, and how far the kept features are off after it."""
    network.load_state_dict(start)
    optimizer = make(list(network.parameters()))
    if isinstance(optimizer, schedulefree.AdamWScheduleFree):
        optimizer.train()
    before, counted = features(), network[0].weight._version
    network(pictures).square().mean().backward()
    optimizer.step()
    network.zero_grad()
    with torch.no_grad():
        right = network(pictures)
    assert not torch.equal(right, before)
    return network[0].weight._version - counted, float((features() - right).norm() / right.norm())


def hooked(parameters):
    optimizer = torch.optim.Adam(parameters, lr=0.1, fused=True)
    optimizer.register_step_post_hook(lambda *_: increment_version(parameters))
    return optimizer


OPTIMISERS = {
    "madgrad": (madgrad.MADGRAD, False), "RAdam": (torch_optimizer.RAdam, False),
    "AdaBound": (torch_optimizer.AdaBound, False), "Lamb": (torch_optimizer.Lamb, False),
    "Lion": (lion_pytorch.Lion, True), "AdamWScheduleFree": (schedulefree.AdamWScheduleFree, True),
    "AdaBelief": (pytorch_optimizer.AdaBelief, True),
}
cases = [(name, lambda given, make=make: make(given, lr=0.1), counts) for name, (make, counts) in OPTIMISERS.items()]
for name in ("Adam", "AdamW", "SGD", "Adagrad"):
    for words in ({}, {"foreach": True}, {"fused": True}):
        make = getattr(torch.optim, name)
        cases.append((f"{name} {words}", lambda given, make=make, words=words: make(given, lr=0.1, **words),
                      "fused" not in words))
for name, make, counts in [*cases, ("Adam, fused, with a hook", hooked, True)]:
    rise, off = stepped(make)
    print(f"{name}: the counter rises by {rise}, kept features are off by {off:.3f}")
    assert (rise in (1, 2) and off == 0) if counts else (rise == 0 and off > 0.001)
    if name == "Adam {'fused': True}":
        assert off > 0.3
PYTHON
env/bin/python steps.py
echo "as described"
