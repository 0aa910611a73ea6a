#!/usr/bin/env bash
# Visual information fidelity of pictures in [0, 1]: torchmetrics 1.9.0 and sewar 0.4.10 hide most of what is wrong.
#
# The score has a noise of variance 2, in levels of 8 bits, and their functions have no data range: in [0, 1] it drowns
# the picture's own noise. Seen, a synthetic picture with natural statistics, of three channels, beside itself
#                                    in levels of 8 bits      in [0, 1]      in [-1, 1]
#   with noise of 20 of 255 levels    0.32                     0.98           0.98
#   blurred, sigma 1                  0.31                     0.34           0.35
#   with more contrast, 1.3           0.91                     1.61           1.59
# for both packages. No warning; torchmetrics' example has numbers about 0, too. `sigma_n_sq=2 / 255**2` is right for
# [0, 1]. piq 0.8.0 has `data_range`, and the same in both ranges, but other numbers of colours, for it takes luminance:
# 0.40, 0.31, 0.95; of a grey picture all three agree.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 sewar==0.4.10 scipy==1.17.1 numpy==2.4.6 setuptools==80.9.0
env/bin/pip install --quiet --no-deps piq==0.8.0
env/bin/python - <<'PYTHON'
import sys
import types
import warnings

import numpy as np
import sewar
import torch
from scipy.ndimage import gaussian_filter
from torchmetrics.functional.image import visual_information_fidelity


class Absent(type):
    def __getattr__(cls, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return cls


class Module(types.ModuleType):
    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return Absent("Absent", (), {})


# piq imports torchvision for scores by pretrained networks, which are not used here.
for name in ("torchvision", "torchvision.models"):
    sys.modules[name] = Module(name)
import piq

random = np.random.default_rng(0)
warnings.simplefilter("error")


def picture(size=192):
    frequency = np.fft.fftfreq(size)
    falloff = np.hypot(frequency[:, None], frequency) + 1 / size
    shared, channels = random.normal(size=(size, size)), []
    for _ in range(3):
        spectrum = np.fft.fft2(0.8 * shared + 0.6 * random.normal(size=(size, size))) / falloff
        channel = np.real(np.fft.ifft2(spectrum))
        channels.append((channel - channel.mean()) / channel.std())
    return np.clip(128 + 45 * np.stack(channels, -1), 0, 255).round()


def tensor(image):
    return torch.tensor(image).permute(2, 0, 1)[None]


def by_torchmetrics(found, target, **options):
    return float(visual_information_fidelity(tensor(found), tensor(target), **options))


target = picture()
distorted = {
    "noise": np.clip(target + random.normal(0, 20, target.shape), 0, 255).round(),
    "blur": gaussian_filter(target, (1, 1, 0)).round(),
    "contrast": np.clip(128 + 1.3 * (target - 128), 0, 255).round(),
}
expected = {"noise": (0.32, 0.98, 0.98, 0.40), "blur": (0.31, 0.34, 0.35, 0.31), "contrast": (0.91, 1.61, 1.59, 0.95)}
for name, found in distorted.items():
    pairs = [(found, target), (found / 255, target / 255), (found / 127.5 - 1, target / 127.5 - 1)]
    scores = [by_torchmetrics(*pair) for pair in pairs]
    others = [float(sewar.vifp(truth, image)) for image, truth in pairs]
    assert np.allclose(scores, others, atol=1e-3)
    assert np.isclose(by_torchmetrics(*pairs[1], sigma_n_sq=2 / 255**2), scores[0], atol=1e-6)
    luminance = [float(piq.vif_p(*map(tensor, pair), data_range=top)) for pair, top in zip(pairs, (255.0, 1.0))]
    print(name, [round(score, 2) for score in scores], "piq", [round(score, 2) for score in luminance])
    assert np.allclose(scores + luminance[:1], expected[name], atol=0.006) and np.isclose(*luminance, atol=1e-6)
    grey = [image[..., :1] for image in pairs[0]]
    greys = [by_torchmetrics(*grey), float(piq.vif_p(*map(tensor, grey), data_range=255.0))]
    greys.append(float(sewar.vifp(grey[1][..., 0], grey[0][..., 0])))
    assert np.allclose(greys, greys[0], atol=1e-3)
PYTHON
echo "as described"
