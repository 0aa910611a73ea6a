#!/usr/bin/env bash
# MNN 3.6.1, from PyTorch 2.13.0's ONNX: a norm over channels becomes one of the whole picture, silently.
#
# `torch.onnx.export` as it comes (onnxscript 0.7.2), MNN's converter, and 3 x 24 x 20 numbers of deviation 1. ONNX
# Runtime 1.32.0 makes of each file what PyTorch makes; MNN:
#   x.norm(dim=1, keepdim=True), p of 1 or 2; logsumexp    one number in place of 24 x 20
#   functional.normalize(x, dim=1)                         all divided by one number: a length of 0.05, not 1
#   functional.cosine_similarity(x, y, dim=1)              a thousandth of it
#   torch.fmod(x, 2)                                       that of Python, torch.remainder: -0.5 becomes 1.5
#   interpolate(scale_factor=2, mode="bicubic")            other numbers in the first row and the first column
#   sums, means, variances, maxima and softmax over channels, bilinear, torch.remainder, and normalize written as
#   x / x.pow(2).sum(1, keepdim=True).sqrt()               equal
# Axes of a norm are an input of the operator since opset 18, and are not read; no error or warning by the converter or
# the run. Features that are normalised, as of perceptual metrics and of attention, are wrong everywhere. Write norms as
# roots of sums, and compare one photograph in both before a network is shipped.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 onnx==1.23.2 onnxscript==0.7.2 onnxruntime==1.32.0 MNN==3.6.1 numpy==2.4.6
cat > compare.py <<'PYTHON'
import contextlib
import io
import os
import subprocess
import sys

import MNN.expr
import MNN.nn
import numpy as np
import onnxruntime
import torch
from torch.nn import functional

torch.manual_seed(0)
picture = torch.randn(1, 3, 24, 20)
CONVERT = "import sys, MNN, _tools; _tools.mnnconvert(['mnnconvert', *sys.argv[1:]])"


class Network(torch.nn.Module):
    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, values):
        return self.function(values)


def both(name, function):
    """What PyTorch and MNN make of the picture; ONNX Runtime agrees with the former."""
    network = Network(function).eval()
    expected = network(picture).numpy()
    with contextlib.redirect_stdout(io.StringIO()):
        torch.onnx.export(network, (picture,), f"{name}.onnx", external_data=False)
    session = onnxruntime.InferenceSession(f"{name}.onnx", providers=["CPUExecutionProvider"])
    by_onnx, = session.run(None, {session.get_inputs()[0].name: picture.numpy()})
    assert np.allclose(by_onnx, expected, atol=1e-4), name
    files = ["--modelFile", f"{name}.onnx", "--MNNModel", f"{name}.mnn", "--bizCode", "a"]
    command = [sys.executable, "-c", CONVERT, "-f", "ONNX", *files]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 0 and os.path.exists(f"{name}.mnn")
    said = (run.stdout + run.stderr).lower()
    assert not any(word in said for word in ("warn", "error", "not support", "fail", "ignore")), said
    net = MNN.nn.load_module_from_file(f"{name}.mnn", [], [])
    given = MNN.expr.const(picture.numpy().ravel().tolist(), list(picture.shape), MNN.expr.NCHW)
    made = MNN.expr.convert(net.forward(given), MNN.expr.NCHW)
    found = np.array(made.read())
    print(f"{name}: {expected.shape}, {expected.ravel()[:3]}; MNN {found.shape}, {found.ravel()[:3]}")
    return expected, found


EQUAL = {
    "sum": lambda x: x.sum(1, keepdim=True),
    "mean": lambda x: x.mean(1, keepdim=True),
    "variance": lambda x: x.var(1, keepdim=True),
    "largest": lambda x: x.amax(1, keepdim=True),
    "softmax": lambda x: x.softmax(1),
    "bilinear": lambda x: functional.interpolate(x, scale_factor=2, mode="bilinear"),
    "remainder": lambda x: torch.remainder(x, 2),
    "by_root": lambda x: x / x.pow(2).sum(1, keepdim=True).sqrt(),
}
for name, function in EQUAL.items():
    expected, found = both(name, function)
    assert found.shape == expected.shape and np.abs(found - expected).max() < 1e-4, name

values = picture.numpy()
whole = np.linalg.norm(values)
for name, function, truth in (
    ("norm", lambda x: x.norm(dim=1, keepdim=True), whole),
    ("norm_of_1", lambda x: x.norm(p=1, dim=1, keepdim=True), np.abs(values).sum()),
    ("logsumexp", lambda x: x.logsumexp(1, keepdim=True), np.log(np.exp(values).sum())),
):
    expected, found = both(name, function)
    assert expected.shape == (1, 1, 24, 20) and found.size == 1 and np.allclose(found, truth, rtol=1e-4)

expected, found = both("normalised", lambda x: functional.normalize(x, dim=1))
lengths = np.linalg.norm(found, axis=1)
print(f"lengths: {np.linalg.norm(expected, axis=1).mean():.3f}; MNN {lengths.mean():.3f}")
assert np.allclose(np.linalg.norm(expected, axis=1), 1, atol=1e-4)
assert np.allclose(found, values / whole, atol=1e-5) and 0.03 < lengths.mean() < 0.06

expected, found = both("cosine", lambda x: functional.cosine_similarity(x, x.flip(2), dim=1))
print(f"cosines: up to {np.abs(expected).max():.3f}; MNN {np.abs(found).max():.4f}")
assert np.abs(expected).max() > 0.99 and np.abs(found).max() < 0.02

expected, found = both("fmod", lambda x: torch.fmod(x, 2))
assert np.allclose(found, np.mod(values, 2), atol=1e-5) and expected.min() < -1.9 and found.min() >= 0

expected, found = both("bicubic", lambda x: functional.interpolate(x, scale_factor=2, mode="bicubic"))
assert found.shape == expected.shape == (1, 3, 48, 40)
difference = np.abs(found - expected)
print(f"bicubic: off by {difference.max():.2f}, but for the first row and column {difference[..., 1:, 1:].max():.6f}")
assert difference[..., 1:, 1:].max() < 1e-4 and difference[..., 0, :].max() > 1 and difference[..., 0].max() > 1
PYTHON
env/bin/python compare.py 2> log.txt || { cat log.txt; exit 1; }
echo "as described"
