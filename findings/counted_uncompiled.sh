#!/usr/bin/env bash
# FLOPs of a compiled model, counted once: PyTorch runs it uncompiled for that, and ever after, without a word.
#
# `FlopCounterMode`, and any other `TorchDispatchMode`, sees the operations of what runs inside of it. In PyTorch 2.13.0 a
# function or module of `torch.compile` that is called inside of one runs as it was written: counts, peaks of memory and
# seconds are those of the uncompiled code, and Python's code object is left alone by the compiler from then on, also
# outside of the mode, for other sizes, and where it had been compiled before. Nothing is raised or logged; only
# `torch.compiler.reset()` takes it back. Whoever counts first and then trains or measures, does so uncompiled.
# Seen, calls of compiled code in turn: outside 1, inside 0, outside 0, another size 0, after the reset 1; and counted
# first: inside 0, outside 0.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.4.6
env/bin/python -W error - <<'PYTHON'
import torch
from torch.utils.flop_counter import FlopCounterMode

calls = []


def backend(graph, inputs):
    def compiled(*given):
        calls.append(len(given))
        return graph(*given)

    return compiled


def products(x):
    return x @ x @ x


def called(function, size=8, counted=False):
    before = len(calls)
    if counted:
        with FlopCounterMode(display=False) as counter:
            function(torch.ones(size, size))
        assert counter.get_total_flops() == 2 * 2 * size**3
    else:
        function(torch.ones(size, size))
    return len(calls) - before


compiled = torch.compile(products, backend=backend)
later = [called(compiled), called(compiled, counted=True), called(compiled), called(compiled, size=9)]
torch.compiler.reset()
again = called(compiled)
torch.compiler.reset()
first = [called(compiled, counted=True), called(compiled)]
print(torch.__version__, later, again, first)
assert (later, again, first) == ([1, 0, 0, 0], 1, [0, 0])
PYTHON
