#!/usr/bin/env bash
# numba 0.67.0: a helper that counts NaN counts none for ever, since a kernel with fastmath was the first to call it.
#
# Options of a kernel, fastmath and error_model, pass to helpers that are compiled for it and say nothing themselves.
# What was compiled is then the helper, for all callers, and with cache=True for all later processes. Plain `@njit`:
#                                                     called first by itself    first by a fast kernel
#   valid(d), how many of 1, NaN, 3, NaN are numbers  2                         4
#   d != d, for the same                              no, yes, no, yes          no, no, no, no
#   ratio(1, 0), where error_model="numpy" was first  ZeroDivisionError         inf
#   total(a), a sum in single precision               49960.043                 49960.195 or so, by the processor
#   a later process, which has no fast kernel         -                         4, inf, the other sum
# So which depths are valid hangs on the order of calls, and on what another program ran beside these files before. Nor
# does the cache know of options: an option that comes from a variable, and has changed, changes nothing. No warning.
# Write fastmath=False and error_model="python" at helpers, which keeps them as they are, or give them a signature.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet numba==0.67.0 numpy==2.4.6
cat > helpers.py <<'PYTHON'
import os

import numpy as np
from numba import njit

OPTIONS = {"fastmath": False, "error_model": "python"} if os.environ.get("SAID") else {}


@njit(cache=True, **OPTIONS)
def valid(depth):
    number = 0
    for row in range(depth.size):
        if not np.isnan(depth[row]):
            number += 1
    return number


@njit(cache=True, **OPTIONS)
def differs(depth):
    return depth != depth


@njit(cache=True, **OPTIONS)
def ratio(a, b):
    return a / b


@njit(cache=True, **OPTIONS)
def total(values):
    result = np.float32(0)
    for row in range(values.size):
        result += values[row]
    return result


@njit(cache=True, fastmath=bool(os.environ.get("FAST")))
def by_variable(depth):
    number = 0
    for row in range(depth.size):
        number += depth[row] == depth[row]
    return number


DEPTH = np.array([1, np.nan, 3, np.nan], np.float32)
VALUES = np.random.default_rng(0).random(100000, dtype=np.float32)


def tell():
    try:
        quotient = float(ratio(1.0, 0.0))
    except ZeroDivisionError as error:
        quotient = type(error).__name__
    print(valid(DEPTH), differs(DEPTH).astype(int).tolist(), quotient, repr(float(total(VALUES))), sep="; ")
PYTHON
cat > alone.py <<'PYTHON'
import helpers

helpers.tell()
PYTHON
cat > fast_first.py <<'PYTHON'
import helpers
from helpers import differs, ratio, total, valid
from numba import njit


@njit(fastmath=True)
def kernel(depth):
    return valid(depth) + differs(depth).sum() + 0 * total(depth)


@njit(error_model="numpy")
def quotients(a, b):
    return ratio(a, b)


kernel(helpers.DEPTH)
quotients(1.0, 2.0)
helpers.tell()
PYTHON
forget() { rm -rf __pycache__; }
run() { env/bin/python -W error "$@"; }
apart="2; [0, 1, 0, 1]; ZeroDivisionError; "
together="4; [0, 0, 0, 0]; inf; "

forget; by_itself="$(run alone.py)"; echo "by itself: $by_itself"
[[ "$by_itself" == "$apart"* && "$(run fast_first.py)" == "$by_itself" ]]
forget; after="$(run fast_first.py)"; echo "after a fast kernel: $after"
[[ "$after" == "$together"* ]]
later="$(run alone.py)"; echo "a later process, without it: $later"
[[ "$later" == "$after" ]]
forget; said="$(SAID=1 run fast_first.py)"; echo "after a fast kernel, options said: $said"
[[ "$said" == "$by_itself" ]]

count='import helpers; print(int(helpers.by_variable(helpers.DEPTH)))'
forget; plain="$(run -c "$count")"; fast="$(FAST=1 run -c "$count")"
forget; fresh="$(FAST=1 run -c "$count")"; kept="$(run -c "$count")"
echo "fastmath by a variable: off $plain, then on $fast; on from the start $fresh, then off $kept"
[[ "$plain $fast $fresh $kept" == "2 2 4 4" ]]
echo "as described"
