#!/usr/bin/env bash
# gsplat 1.5.3's exporter: one infinite opacity empties the file, and two of its three formats sort the rows.
#
# `gsplat.export_splats`, read from its public wheel, run with PyTorch 2.13 on a processor.
# 1. One infinite opacity empties the file. The exporter leaves out Gaussians with values that are not finite, row by
#    row for all properties but opacity, of which one such value leaves out every Gaussian. An infinite logit is what an
#    opaque Gaussian has whose alpha was stored as 255 of 255 and turned back into a logit without a clamp.
#    Seen: a PLY of 0 vertices for 6 Gaussians, no warning, no error. An infinite coordinate costs its row alone: 5.
# 2. Two of its three formats sort. `ply` keeps the order of the rows; `splat` and `ply_compressed` write them along a
#    Morton curve, so that masks, labels or another style's colours stored by row no longer belong to them.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 numpy==2.2.6 plyfile==1.1.2
env/bin/pip download --quiet --no-deps gsplat==1.5.3
unzip -q gsplat-1.5.3-*.whl "gsplat/exporter.py"  # the module alone: the package builds CUDA code when it is imported
env/bin/python - <<'PYTHON'
import importlib.util
import io

import numpy as np
import torch
from plyfile import PlyData

spec = importlib.util.spec_from_file_location("exporter", "gsplat/exporter.py")
exporter = importlib.util.module_from_spec(spec)
spec.loader.exec_module(exporter)

torch.manual_seed(0)
means, scales, quats = torch.rand(6, 3), torch.randn(6, 3), torch.randn(6, 4)
opacities, sh0, shN = torch.randn(6), torch.rand(6, 1, 3), torch.rand(6, 15, 3)


def rows(format, **changed):
    given = dict(means=means, scales=scales, quats=quats, opacities=opacities, sh0=sh0, shN=shN) | changed
    return exporter.export_splats(**given, format=format)


def count(data):
    return len(PlyData.read(io.BytesIO(data))["vertex"].data)


one = torch.tensor([0, 0, 1, 0, 0, 0], dtype=torch.bool)
opaque = count(rows("ply", opacities=opacities.masked_fill(one, torch.inf)))
moved = count(rows("ply", means=means.masked_fill(one[:, None], torch.inf)))
print(f"rows of 6 with one infinite opacity: {opaque}; with one infinite position: {moved}")

ply = PlyData.read(io.BytesIO(rows("ply")))["vertex"]["x"]
splat = np.frombuffer(rows("splat"), np.uint8).reshape(6, 32)[:, :4].copy().view(np.float32)[:, 0]
order = [int(np.abs(means[:, 0].numpy() - x).argmin()) for x in splat]
print(f"order of rows in ply: {'kept' if np.array_equal(ply, means[:, 0].numpy()) else 'changed'}; in splat: {order}")
assert (opaque, moved) == (0, 5), "gsplat treats an infinite opacity otherwise now"
assert np.array_equal(ply, means[:, 0].numpy()) and sorted(order) == list(range(6)) != order, "the order changed"
PYTHON
