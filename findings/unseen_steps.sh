#!/usr/bin/env bash
# A step between two backward passes, as with two losses: PyTorch 2.13.0's fused optimisers hide it from autograd.
#
# Two losses of one output; the first is differentiated, the optimiser steps, and the second is differentiated. What
# comes of the second gradient, at weights that are not those that its activations were computed with any more:
#   Adam, AdamW, SGD, Adagrad, by default and with foreach=True       the error "modified by an inplace operation"
#   the same four with fused=True                                     no error; Adam's gradient is off by 63 %
#   madgrad 1.3, torch-optimizer 0.3.0 (RAdam, AdaBound, Lamb)        no error, and off by 1 to 47 %
#   lion-pytorch 0.2.5, schedulefree 1.4.1, pytorch_optimizer 4.1.0   the error
# PyTorch counts writes to a tensor (`_version`), by which it also knows that what it kept for a backward pass is stale.
# Fused kernels, and optimisers that write to `.data`, do not raise that count. So `fused=True`, as of a faster run of
# the same script, makes a bug silent that was an error before; and what a program keeps by that count is stale.
# Differentiate both losses before the step. `torch.autograd.graph.increment_version(parameters)` after it, which a hook
# can call (`optimizer.register_step_post_hook`), brings the error back. No warning by any.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6 lion-pytorch==0.2.5 schedulefree==1.4.1 madgrad==1.3 \
  pytorch_optimizer==4.1.0 torch-optimizer==0.3.0
env/bin/python - <<'PYTHON'
import lion_pytorch
import madgrad
import pytorch_optimizer
import schedulefree
import torch
import torch_optimizer
from torch.autograd.graph import increment_version

torch.manual_seed(0)
network = torch.nn.Sequential(torch.nn.Linear(8, 16), torch.nn.Tanh(), torch.nn.Linear(16, 4))
start, pictures = {name: value.clone() for name, value in network.state_dict().items()}, torch.randn(32, 8)


def second_gradient(make, after=lambda parameters: None):
    """How far the second gradient is off, or None where PyTorch raises; and by how much the count of writes rose."""
    network.load_state_dict(start)
    parameters = list(network.parameters())
    for parameter in parameters:
        parameter.grad = None
    optimizer = make(parameters)
    if isinstance(optimizer, schedulefree.AdamWScheduleFree):
        optimizer.train()
    output = network(pictures)
    one, other = output.square().mean(), (output - 1).abs().mean()
    right = torch.autograd.grad(other, parameters, retain_graph=True)
    one.backward(retain_graph=True)
    writes = parameters[0]._version
    optimizer.step()
    assert not torch.equal(parameters[0], start["0.weight"])
    after(parameters)
    optimizer.zero_grad()
    try:
        other.backward()
    except RuntimeError as error:
        assert "modified by an inplace operation" in str(error)
        return None, parameters[0]._version - writes
    off = max(float((each.grad - truth).norm() / truth.norm()) for each, truth in zip(parameters, right))
    return off, parameters[0]._version - writes


for name in ("Adam", "AdamW", "SGD", "Adagrad"):
    for words in ({}, {"foreach": True}, {"fused": True}):
        off, writes = second_gradient(lambda given: getattr(torch.optim, name)(given, lr=0.1, **words))
        print(f"{name} {words}: writes {writes}, " + ("an error" if off is None else f"off by {off:.3f}"))
        if "fused" in words:
            assert writes == 0 and (0.005 < off < 0.03 if name == "SGD" else 0.5 < off < 0.8)
        else:
            assert writes > 0 and off is None
THEIRS = {
    "madgrad": (madgrad.MADGRAD, True), "RAdam": (torch_optimizer.RAdam, True),
    "AdaBound": (torch_optimizer.AdaBound, True), "Lamb": (torch_optimizer.Lamb, True),
    "Lion": (lion_pytorch.Lion, False), "AdamWScheduleFree": (schedulefree.AdamWScheduleFree, False),
    "AdaBelief": (pytorch_optimizer.AdaBelief, False),
}
for name, (optimizer, hidden) in THEIRS.items():
    off, writes = second_gradient(lambda given: optimizer(given, lr=0.1))
    print(f"{name}: writes {writes}, " + ("an error" if off is None else f"off by {off:.3f}"))
    assert (off is not None and off > 0.005 and writes == 0) if hidden else (off is None and writes > 0)

off, writes = second_gradient(lambda given: torch.optim.Adam(given, lr=0.1, fused=True), increment_version)
print(f"Adam with increment_version: writes {writes}, off by {off}")
assert off is None and writes == 1
hooked = torch.optim.Adam(network.parameters(), lr=0.1, fused=True)
hooked.register_step_post_hook(lambda stepped, *_: increment_version(stepped.param_groups[0]["params"]))
writes = network[0].weight._version
network(pictures).sum().backward()
hooked.step()
assert network[0].weight._version == writes + 1
PYTHON
echo "as described"
