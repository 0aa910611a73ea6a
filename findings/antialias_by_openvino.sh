#!/usr/bin/env bash
# OpenVINO 2026.4.1: an ONNX model that makes pictures smaller with antialiasing makes them smaller without it.
#
# `interpolate(..., antialias=True)` by PyTorch 2.13.0, which `torch.onnx.export` writes as Resize with antialias = 1.
# Noise of deviation 1, from 64 to 16 pixels a side; the deviation of what comes out, and the largest difference from
# PyTorch:
#                                         bilinear         bicubic         bicubic, from 64 to 128
#   PyTorch                               0.17             0.21            0.81
#   onnxruntime 1.32.0, of the ONNX       0.17, 0          0.21, 0         0.81, 0
#   OpenVINO, of the same file            0.49, 1.3        0.63, 1.8       0.81, 0.08
#   OpenVINO, convert_model(the module)   0.17, 0          0.21, 0         0.81, 0
# No warning. Backbones, perceptual losses and encoders that take a small picture get another one, full of moire. Give
# OpenVINO the module, or make the picture small before.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 onnx==1.23.2 onnxruntime==1.32.0 onnxscript==0.7.2 openvino==2026.4.1 \
    numpy==2.4.6 setuptools==80.9.0
env/bin/python - 2> told.log <<'PYTHON'
import logging
import warnings

import numpy as np
import onnx
import onnxruntime
import openvino
import torch

logging.disable(logging.WARNING)
torch.set_num_threads(1)
picture = torch.tensor(np.random.default_rng(0).normal(size=(1, 3, 64, 64)).astype(np.float32))


class Smaller(torch.nn.Module):
    def __init__(self, side, mode):
        super().__init__()
        self.options = {"size": (side, side), "mode": mode, "antialias": True}

    def forward(self, x):
        return torch.nn.functional.interpolate(x, **self.options)


def by_openvino(model):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        compiled = openvino.compile_model(model, "CPU", {"INFERENCE_PRECISION_HINT": "f32"})
    return compiled([picture.numpy()])[0]


for side, mode, expected in (
    (16, "bilinear", (0.17, 0.49, 1.33)),
    (16, "bicubic", (0.21, 0.63, 1.83)),
    (128, "bicubic", (0.81, 0.81, 0.08)),
):
    module = Smaller(side, mode).eval()
    right = module(picture).numpy()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(module, (picture,), "m.onnx", dynamo=True, verbose=False)
        converted = openvino.convert_model(module, example_input=picture)
    (node,) = (node for node in onnx.load("m.onnx").graph.node if node.op_type == "Resize")
    assert {a.name: a.i for a in node.attribute}["antialias"] == 1
    session = onnxruntime.InferenceSession("m.onnx", providers=["CPUExecutionProvider"])
    found = {
        "onnxruntime": session.run(None, {session.get_inputs()[0].name: picture.numpy()})[0],
        "OpenVINO, of ONNX": by_openvino("m.onnx"),
        "OpenVINO, of the module": by_openvino(converted),
    }
    print(f"{mode} to {side}: PyTorch, deviation {right.std():.2f}")
    for name, result in found.items():
        difference = np.abs(result - right).max()
        print(f"   {name:24} deviation {result.std():.2f}, largest difference {difference:.2f}")
        if name == "OpenVINO, of ONNX":
            assert np.allclose((right.std(), result.std(), difference), expected, rtol=0.03, atol=0.006)
        else:
            assert difference < 1e-4
PYTHON
echo "as described"
