#!/usr/bin/env bash
# Networks for phones by pnnx 20261020 (PyTorch 2.13.0 to ncnn): six ordinary operations become others, silently.
#
# One convolution of 1 x 1, and then, for 3 x 24 x 20 numbers of deviation 1, what ncnn 1.0.20261020 makes of the same
# traced module in single precision, fp16=0, without the GPU:
#                                                        ncnn
#   Conv2d(padding_mode="circular")                      zeros beyond the edge: a seam in textures and panoramas
#   interpolate(scale_factor=0.5, mode="nearest-exact")  "nearest": other pixels, all of them
#   torch.remainder(x, 1), as of hues                    that of the nearest whole number: 0.8 becomes -0.2
#   torch.div(x, 0.3, rounding_mode="floor")             the quotient, not rounded
#   avg_pool2d(3, 2, 1, ceil_mode=True)                  other means at two edges, by a third of their size
#   x ** 3, of negative numbers                          not a cube: 2.4e38 for all of them, here
#   x ** 2; padding_mode="reflect" and "replicate"; torch.fmod; "nearest", "bilinear" and "bicubic" of a half; pixel
#   shuffle; instance and group norms; softmax over channels; flip; avg_pool2d without ceil_mode        equal
# Neither the converter nor the run says a word about these. Compare what ncnn makes of one photograph with PyTorch
# before a network is shipped. Write x * x * x, x - torch.floor(x), and torch.floor(x / 0.3); pad by a concatenation of
# slices; shift by a pixel, x[..., 1:, 1:], before "nearest".
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 pnnx==20261020 ncnn==1.0.20261020 numpy==2.4.6
cat > compare.py <<'PYTHON'
import os
import re
import subprocess

import ncnn
import numpy as np
import pnnx
import torch
from torch import nn
from torch.nn import functional

torch.manual_seed(0)
CONVERTER = getattr(pnnx, "EXEC_PATH", os.path.join(os.path.dirname(pnnx.__file__), "bin", "pnnx"))
picture = torch.randn(1, 3, 24, 20)
first = nn.Conv2d(3, 3, 1)
with torch.no_grad():
    first.weight.copy_(torch.eye(3)[:, :, None, None])
    first.bias.zero_()


class Network(nn.Module):
    def __init__(self, function, layer=None):
        super().__init__()
        self.first, self.layer, self.function = first, layer, function

    def forward(self, values):
        values = self.first(values)
        return self.function(values) if self.layer is None else self.function(self.layer(values))


def same(values):
    return values


def both(name, function, layer=None):
    """What PyTorch and ncnn make of the picture."""
    network = Network(function, layer).eval()
    with torch.no_grad():
        expected = network(picture)[0].numpy()
        torch.jit.trace(network, picture).save(f"{name}.pt")
    run = subprocess.run([CONVERTER, f"{name}.pt", "inputshape=[1,3,24,20]", "fp16=0"], capture_output=True, text=True)
    assert run.returncode == 0
    said = re.findall(r"(?im)^.*(?:ignore|not support|warn|todo|unknown|fallback).*$", run.stdout + run.stderr)
    assert not said, said
    net = ncnn.Net()
    net.opt.use_vulkan_compute = False
    net.opt.use_fp16_packed = net.opt.use_fp16_storage = net.opt.use_bf16_storage = False
    assert net.load_param(f"{name}.ncnn.param") == 0 and net.load_model(f"{name}.ncnn.bin") == 0
    extractor = net.create_extractor()
    extractor.input("in0", ncnn.Mat(picture[0].numpy()).clone())
    code, found = extractor.extract("out0")
    found = np.array(found)
    assert code == 0 and found.shape == expected.shape, (name, found.shape, expected.shape)
    print(f"{name}: differ by {np.abs(found - expected).max():.3g}, PyTorch's largest is {np.abs(expected).max():.3g}")
    return expected, found


def resized(mode):
    return lambda values: functional.interpolate(values, scale_factor=0.5, mode=mode)


padded = {mode: nn.Conv2d(3, 4, 3, padding=1, padding_mode=mode) for mode in ("circular", "reflect", "replicate")}
EQUAL = {
    "square": (lambda values: values ** 2,),
    "reflect": (same, padded["reflect"]),
    "replicate": (same, padded["replicate"]),
    "fmod": (lambda values: torch.fmod(values, 1.0),),
    "nearest": (resized("nearest"),),
    "bilinear": (resized("bilinear"),),
    "bicubic": (resized("bicubic"),),
    "shuffle": (lambda values: functional.pixel_shuffle(values, 2), nn.Conv2d(3, 12, 1)),
    "instance_norm": (same, nn.InstanceNorm2d(3, affine=True)),
    "group_norm": (same, nn.Sequential(nn.Conv2d(3, 8, 1), nn.GroupNorm(4, 8))),
    "softmax": (lambda values: torch.softmax(values, 1),),
    "flip": (lambda values: torch.flip(values, (3,)),),
    "average": (lambda values: functional.avg_pool2d(values, 3, 2, 1),),
    # What the header says to write in place of others.
    "product": (lambda values: values * values * values,),
    "hue": (lambda values: values - torch.floor(values),),
    "floored": (lambda values: torch.floor(values / 0.3),),
    "shifted": (lambda values: functional.interpolate(functional.pad(values[..., 1:, 1:], (0, 1, 0, 1)),
                                                      scale_factor=0.5, mode="nearest"),),
    "around": (lambda values: torch.cat([values[..., -1:], values, values[..., :1]], 3),),
}
for name, case in EQUAL.items():
    expected, found = both(name, *case)
    assert np.abs(expected - found).max() < 1e-3 * max(1, np.abs(expected).max()), name

expected, found = both("circular", same, padded["circular"])
with torch.no_grad():
    zeros = functional.conv2d(picture, padded["circular"].weight, padded["circular"].bias, padding=1)[0].numpy()
assert np.abs(found - zeros).max() < 1e-4 and np.abs(expected - zeros).max() > 0.3
assert np.abs(expected - found)[:, 1:-1, 1:-1].max() < 1e-4

expected, found = both("nearest_exact", resized("nearest-exact"))
assert np.allclose(expected, picture[0, :, 1::2, 1::2]) and np.allclose(found, picture[0, :, ::2, ::2])

expected, found = both("remainder", lambda values: torch.remainder(values, 1.0))
negative = picture[0].numpy() < 0
assert np.allclose(found, picture[0].numpy() - np.rint(picture[0].numpy()), atol=1e-5)
assert expected.min() >= 0 and expected.max() > 0.9 and found.min() < -0.4 and found.max() <= 0.5

expected, found = both("divided", lambda values: torch.div(values, 0.3, rounding_mode="floor"))
assert np.allclose(found, picture[0].numpy() / 0.3, atol=1e-4) and np.abs(expected - found).max() > 0.9

expected, found = both("ceiling", lambda values: functional.avg_pool2d(values, 3, 2, 1, ceil_mode=True))
difference = np.abs(expected - found)
assert difference[:, :-1, :-1].max() < 1e-4 and difference.max() > 0.1
edge = np.abs(expected[:, -1, 1:-1]) > 0.05
assert np.allclose((found[:, -1, 1:-1] / expected[:, -1, 1:-1])[edge], 2 / 3, atol=0.01)

expected, found = both("cube", lambda values: values ** 3)
assert np.allclose(found[~negative], expected[~negative], rtol=1e-3, atol=1e-4)
assert not np.isclose(found[negative], expected[negative], rtol=0.1).any()
print(f"cubes of {picture[0].numpy()[negative][:3]}: {found[negative][:3]}")
PYTHON
env/bin/python compare.py 2> log.txt || { cat log.txt; exit 1; }
echo "as described"
