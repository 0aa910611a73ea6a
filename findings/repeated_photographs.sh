#!/usr/bin/env bash
# Photographs beside their renders in several styles, each photograph once for each style: precision falls from 1 to 0.
#
# Pairs of a photograph and its stylization hold a photograph as often as there are styles. Precision asks for the
# distance of a real picture to its k-th neighbour among the real ones, which is 0 once it is there k + 1 times. 50
# photographs, and a render near each of them in each style, as features of 64 numbers:
#   prdc 0.2, nearest_k=5                       precision, coverage and density are 1, 1 and 1.2 with five styles,
#                                               and 0, 0 and 0 with six
#   torch-fidelity 0.4.0, its default of 3      precision 1 with three styles, 0 with four
# Of renders unlike the photographs precision is 0.82 with one style, 0.43 with four and 0 with six by prdc, though they
# are of one distribution. Recall stays. No warning. Give every photograph once.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 prdc==0.2 scikit-learn==1.9.1 scipy==1.17.1 numpy==2.4.6 pillow==13.0.0 tqdm
env/bin/pip install --quiet --no-deps torch-fidelity==0.4.0
env/bin/python -W error - <<'PYTHON'
import contextlib
import io
import sys
import types

import numpy as np
import torch
from prdc import compute_prdc


class Absent(type):
    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return cls


class Module(types.ModuleType):
    __path__ = []

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Absent("Absent", (), {})


# torch-fidelity imports torchvision for pictures and networks, which are not used here.
for name in ("", ".datasets", ".transforms", ".transforms.functional", ".models", ".models.feature_extraction"):
    sys.modules[f"torchvision{name}"] = Module(f"torchvision{name}")
from torch_fidelity.metric_prc import prc_features_to_metric  # noqa: E402


def by_prdc(real, fake):
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        found = compute_prdc(real, fake, nearest_k=5)
    assert said.getvalue().startswith("Num real") and said.getvalue().count("\n") == 1
    return [round(float(found[name]), 2) for name in ("precision", "coverage", "density", "recall")]


def by_fidelity(fake, real):
    options = {"prc_neighborhood": 3, "prc_batch_size": 1000, "save_cpu_ram": False, "verbose": False}
    real, fake = torch.tensor(real, dtype=torch.float32), torch.tensor(fake, dtype=torch.float32)
    found = prc_features_to_metric(fake, real, **options)
    return [round(float(found[name]), 2) for name in ("precision", "recall")]


rng = np.random.default_rng(0)
photographs = rng.standard_normal((50, 64))
found = {}
for styles in (1, 3, 4, 5, 6):
    real = np.repeat(photographs, styles, axis=0)
    near, other = real + 0.3 * rng.standard_normal(real.shape), rng.standard_normal(real.shape)
    found[styles] = by_prdc(real, near), by_fidelity(near, real), by_prdc(real, other)
    print(f"{styles} styles: prdc {found[styles][0]}, torch-fidelity {found[styles][1]}, unlike {found[styles][2]}")
assert all(found[styles][0][:2] == [1, 1] for styles in (1, 3, 4, 5)) and 1.1 < found[5][0][2] < 1.3
assert found[6][0] == [0, 0, 0, 1] and found[6][2][:3] == [0, 0, 0]
assert [found[styles][1][0] for styles in found] == [1, 1, 0, 0, 0] and {found[n][1][1] for n in found} == {1}
assert abs(found[1][2][0] - 0.82) < 0.05 and abs(found[4][2][0] - 0.43) < 0.05
assert all(found[styles][2][3] > 0.7 for styles in found)
PYTHON
echo "as described"
