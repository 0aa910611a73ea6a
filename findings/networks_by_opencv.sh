#!/usr/bin/env bash
# Networks from PyTorch 2.13.0 by OpenCV 5.0.0's dnn and by tract 0.23.9: layers whose pictures are others, silently.
#
# Exported as ONNX in two ways, as by default ("new") and with dynamo=False ("old"); ONNX Runtime 1.32.0 is right on each
# file, and these were not. Guessed: none or one of OpenCV's, none of tract's.
#                                             OpenCV
#   interpolate(antialias=True), smaller      not antialiased: noise made four times smaller has a deviation of 0.144
#                                             for 0.047
#   interpolate(scale_factor=1.7), 24 rows    stretched to the whole rows, 40, by 1.667: a ramp is off by half a pixel
#   grid_sample(mode="bicubic")               new: bilinear; old: without overshoot, cut to the range of the pixels around
#   AvgPool2d(3, 2, ceil_mode=True)           dark at the right and at the bottom, 0.67 for 1, in the corner 0.44
#   logaddexp(a, b), as of distances          softplus(b): logaddexp(1, 2) is 2.13 for 2.31
#   .to(uint8), levels of a picture           old: nothing is rounded
#                                             tract
#   CELU(0.5), below 0                        twice as far down, for it leaves out the factor: -1 for -0.5; ELU is right
#   whole numbers % 3                         as in C, -1 for 2
# No warning by either. Resize by whole steps with a size, pad by 1 in place of ceil_mode, and compare one photograph in
# both programs before thousands are styled.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 onnx==1.23.2 onnxscript==0.7.2 onnxruntime==1.32.0 \
  opencv-python-headless==5.0.0.93 tract==0.23.9 numpy==2.4.6
OPENCV_LOG_LEVEL=OFF env/bin/python - 2> errors.log <<'PYTHON' || { cat errors.log; exit 1; }
import cv2
import numpy as np
import onnxruntime
import torch
import torch.nn.functional as F
import tract
from torch import nn


class Layer(nn.Module):
    def __init__(self, function):
        super().__init__()
        self.function = function

    def forward(self, picture):
        return self.function(picture)


def grid(rows, columns, right):
    across, down = torch.linspace(-1, 1, columns) + 2 * right / (columns - 1), torch.linspace(-1, 1, rows)
    return torch.stack(torch.meshgrid(across, down, indexing="xy"), dim=-1)[None]


def by_opencv(path, given):
    network = cv2.dnn.readNetFromONNX(path)
    network.setInput(given)
    return network.forward()


def by_tract(path, given):
    return tract.onnx().load(path).into_model().into_runnable().run([given])[0].to_numpy()


def results(layer, given, kinds=("new", "old"), programs=(by_opencv, by_tract)):
    network = (layer if isinstance(layer, nn.Module) else Layer(layer)).eval()
    with torch.no_grad():
        truth = network(given).numpy()
        for kind in kinds:
            path = f"{kind}.onnx"
            if kind == "new":
                torch.onnx.export(network, (given,), path, dynamo=True, verbose=False)
            else:
                torch.onnx.export(network, (given,), path, dynamo=False, opset_version=17)
            session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
            reference, = session.run(None, {session.get_inputs()[0].name: given.numpy()})
            assert np.allclose(reference, truth, atol=1e-4)
            for program in programs:
                found = program(path, given.numpy())
                assert found.shape == truth.shape
                yield f"{program.__name__}, {kind}", found, truth


noise = torch.rand(1, 1, 256, 256, generator=torch.Generator().manual_seed(0))
for name, found, truth in results(lambda x: F.interpolate(x, (64, 64), mode="bilinear", antialias=True), noise, ("new",)):
    print(f"antialiased, {name}: a deviation of {found.std():.3f} for {truth.std():.3f}")
    assert abs(found.std() - 0.144) < 0.002 if "opencv" in name else np.allclose(found, truth, atol=1e-4)

ramp = torch.arange(24.0)[None, None, :, None].expand(1, 1, 24, 20).contiguous()
for name, found, truth in results(lambda x: F.interpolate(x, scale_factor=1.7, mode="bilinear"), ramp):
    print(f"scale 1.7, {name}: row 38 is {found[0, 0, 38, 0]:.3f} for {truth[0, 0, 38, 0]:.3f}")
    assert np.isclose(found[0, 0, 38, 0], 38.5 * 24 / 40 - 0.5 if "opencv" in name else 38.5 / 1.7 - 0.5, atol=1e-3)
for name, found, truth in results(lambda x: F.interpolate(x, (40, 34), mode="bilinear"), ramp):
    assert np.allclose(found, truth, atol=1e-4)

moved, dot = grid(8, 10, 0.5), torch.zeros(1, 1, 8, 10)
dot[0, 0, 4, 5] = 1
for mode in ("bicubic", "bilinear"):
    for name, found, truth in results(lambda x: F.grid_sample(x, moved, mode=mode, align_corners=True), dot):
        print(f"warp, {mode}, {name}: {found[0, 0, 4, 3:7]} for {truth[0, 0, 4, 3:7]}")
        if mode == "bicubic" and "opencv" in name:
            middle = 0.5 if "new" in name else 0.59375
            assert np.allclose(found[0, 0, 4, 3:7], [0, middle, middle, 0], atol=1e-4)
        else:
            assert np.allclose(found, truth, atol=1e-4)

for name, found, truth in results(nn.AvgPool2d(3, 2, ceil_mode=True), torch.ones(1, 1, 8, 10)):
    print(f"pooled, {name}: {found[0, 0, -1]}")
    assert np.allclose(truth, 1)
    shares = np.outer([3, 3, 3, 2], [3, 3, 3, 3, 2]) / 9
    assert np.allclose(found, shares if "opencv" in name else 1)

for name, found, truth in results(lambda x: torch.logaddexp(x, 2 * x), torch.tensor([[0.0, 1, 2, 3]]), ("new",)):
    print(f"logaddexp, {name}: {found[0]} for {truth[0]}")
    assert np.allclose(found, np.log1p(np.exp([0.0, 2, 4, 6])) if "opencv" in name else truth, atol=1e-4)

for name, found, truth in results(lambda x: (255 * x).to(torch.uint8).float(), torch.tensor([[0.1, 0.5, 0.999]])):
    print(f"levels, {name}: {found[0]} for {truth[0]}")
    assert np.allclose(found, [[25.5, 127.5, 254.745]] if name == "by_opencv, old" else truth, atol=1e-3)

below = torch.linspace(-4, 4, 9)[None]
for alpha in (1.0, 0.5):
    for name, found, truth in results(nn.CELU(alpha), below):
        print(f"CELU({alpha:g}), {name}: {found.min():.2f} for {truth.min():.2f}")
        without = torch.where(below < 0, torch.expm1(below / alpha), below)
        assert np.allclose(found, without if "tract" in name else truth, atol=1e-4)
for name, found, truth in results(nn.ELU(0.5), below):
    assert np.allclose(found, truth, atol=1e-4)

for name, found, truth in results(lambda x: (torch.floor(x).long() % 3).float(), below):
    print(f"whole numbers % 3, {name}: {found[0]} for {truth[0]}")
    assert np.allclose(found, np.fmod(below, 3) if "tract" in name else truth)
PYTHON
echo "as described"
