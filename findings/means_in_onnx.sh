#!/usr/bin/env bash
# PyTorch 2.13.0 to ONNX: a mean over groups becomes the last member of each group, and three more change, silently.
#
# `torch.onnx.export` as it comes (onnxscript 0.7.2), run by onnxruntime 1.32.0:
#                                                             PyTorch              the ONNX file
#   scatter_reduce "mean" of 1, 3 | 2, 4, 9 | 5               2, 5, 5              3, 9, 5
#                  "sum", "amax", "amin", "prod"              equal
#   logaddexp(100, 100), (-200, -200)                         100.69, -199.31      inf, -inf
#   logsumexp of 100, 100, and of -200, -200                  equal
# and noise of deviation 1, 64 x 64 pixels, by `interpolate(scale_factor=...)`; the largest difference:
#                                              0.3      0.5      0.7
#   "nearest"                                  4.9      0        0
#   "bilinear"                                 0        0        0
#   "bilinear", antialias=True                 0.2      0        2.1
#   "bicubic", antialias=True                  0.2      0        2.7
#   the same with recompute_scale_factor=True, or with `size`: 0
# The mean is written as a scatter without a reduction (that ONNX has no mean is known publicly), logaddexp as the
# logarithm of a sum of exponentials, and the last ones with a ratio of sizes in the place of the factor, or the factor
# in the place of the ratio. No UserWarning. A mean can be written as two sums, logaddexp as logsumexp of a stack; give
# sizes.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 onnx==1.23.2 onnxscript==0.7.2 onnxruntime==1.32.0 numpy==2.4.6
env/bin/python - 2> log.txt <<'PYTHON'
import contextlib
import io
import warnings

import numpy as np
import onnx
import onnxruntime
import torch
from torch.nn.functional import interpolate

torch.manual_seed(0)


class Model(torch.nn.Module):
    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, *values):
        return self.function(*values)


def both(function, *values):
    """What PyTorch and the file make of the values."""
    model = Model(function).eval()
    expected = model(*values)
    with warnings.catch_warnings(record=True) as caught, contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("always")
        torch.onnx.export(model, values, "model.onnx")
    said = [str(warning.message) for warning in caught if issubclass(warning.category, UserWarning)]
    assert not said, said
    onnx.checker.check_model("model.onnx")
    session = onnxruntime.InferenceSession("model.onnx", providers=["CPUExecutionProvider"])
    names = [entry.name for entry in session.get_inputs()]
    found, = session.run(None, {name: value.numpy() for name, value in zip(names, values, strict=True)})
    assert found.shape == tuple(expected.shape)
    return expected.numpy(), found


groups = torch.tensor([0, 0, 1, 1, 1, 2])
members = torch.tensor([1.0, 3, 2, 4, 9, 5])
for name in ("mean", "sum", "amax", "amin", "prod"):
    expected, found = both(lambda base, index, values, name=name: base.scatter_reduce(
        0, index, values, name, include_self=False), torch.zeros(3), groups, members)
    print(f"scatter_reduce {name}: {expected} and {found}")
    if name == "mean":
        assert expected.tolist() == [2, 5, 5] and found.tolist() == [3, 9, 5]
        operators = [node.op_type for node in onnx.load("model.onnx").graph.node]
        print(f"    {operators}")
    else:
        assert np.allclose(expected, found)
pair = torch.tensor([100.0, -200.0])
expected, found = both(torch.logaddexp, pair, pair.clone())
print(f"logaddexp: {expected} and {found}")
assert np.allclose(expected, [100.693, -199.307], atol=0.001) and found.tolist() == [float("inf"), -float("inf")]
expected, found = both(lambda values: torch.logsumexp(values, 0), torch.stack([pair, pair]))
print(f"logsumexp: {expected} and {found}")
assert np.allclose(expected, found)

picture = torch.randn(1, 1, 64, 64)
FACTORS = (0.3, 0.5, 0.7)
EXPECTED = {("nearest", False): (4.9, 0, 0), ("bilinear", False): (0, 0, 0),
            ("bilinear", True): (0.2, 0, 2.1), ("bicubic", True): (0.2, 0, 2.7)}
for (mode, antialias), differences in EXPECTED.items():
    options = {"mode": mode, "antialias": antialias}
    row = []
    for factor, difference in zip(FACTORS, differences, strict=True):
        size = int(64 * factor)
        calls = {"factor": {"scale_factor": factor},
                 "recomputed": {"scale_factor": factor, "recompute_scale_factor": True}, "size": {"size": size}}
        for name, call in calls.items():
            if name != "factor" and not difference:
                continue
            expected, found = both(lambda values, call=call: interpolate(values, **options, **call), picture)
            largest = np.abs(expected - found).max()
            assert expected.shape[-1] == size
            if name == "factor":
                row.append(round(float(largest), 3))
                assert abs(largest - difference) < (0.06 if difference else 1e-4), (mode, antialias, factor, largest)
            else:
                assert largest < 1e-4, (mode, antialias, factor, name, largest)
    print(f"{mode}, antialias {antialias}: {row}")
PYTHON
echo "as described"
