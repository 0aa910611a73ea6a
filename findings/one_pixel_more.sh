#!/usr/bin/env bash
# One row of pixels more, and a score of the same render is another: SSIM 0.57 of 383 pixels, 0.88 of 384, by piq 0.8.0.
#
# Some scores halve large pictures first, by the shorter side over 256. Packages round that at different sides, or never
# halve. A picture 540 pixels wide, with noise of 13 levels of 255, and of this height:
#                                   383                 384                 511 and 512
#   piq SSIM                        0.57                0.88                0.88
#       FSIM, VSI, SR-SIM           0.87, 0.96, 0.94    0.96, 0.99, 0.98    as before
#       MDSI (0 is best)            0.38                0.28                0.28
#   piqa 1.3.2 FSIM                 0.87                0.87                0.87 and 0.96
#              MDSI                 0.38                0.38                0.38 and 0.28
#   SSIM of piqa, torchmetrics 1.9.0, kornia 0.9.0 and pytorch-msssim 1.0.0: 0.57 for all
# No warning. From 384 to 511 pixels, as most evaluations of this field have them, FSIM is 0.96 by piq and 0.87 by piqa.
# Report the size in pixels and the package with such a score, or halve both pictures oneself.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 numpy==2.4.6 scipy==1.17.1
env/bin/pip install --quiet --no-deps piq==0.8.0 piqa==1.3.2 pytorch-msssim==1.0.0
env/bin/pip install --quiet kornia==0.9.0
env/bin/python - <<'PYTHON'
import sys
import types
import warnings

import numpy as np
import torch
import torchmetrics.functional.image as tm
from scipy.ndimage import gaussian_filter


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


# Both import torchvision for scores by pretrained networks, which are not used here.
for name in ("torchvision", "torchvision.models", "torchvision.models.utils"):
    sys.modules[name] = Module(name)
with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import kornia
    import piq
    import piqa
    import pytorch_msssim

rng = np.random.default_rng(0)
picture = np.zeros((3, 540, 540))
for scale in (1, 2, 4, 8, 16, 32):
    picture += scale * gaussian_filter(rng.standard_normal(picture.shape), (0, scale, scale))
picture = (picture - picture.min()) / (picture.max() - picture.min())
noisy = np.clip(picture + 0.05 * rng.standard_normal(picture.shape), 0, 1)
picture, noisy = (torch.tensor(image, dtype=torch.float32)[None] for image in (picture, noisy))
scores = {
    "piq SSIM": (piq.ssim, [0.57, 0.88, 0.88, 0.88]),
    "piq FSIM": (piq.fsim, [0.87, 0.96, 0.96, 0.96]),
    "piq VSI": (piq.vsi, [0.96, 0.99, 0.99, 0.99]),
    "piq SR-SIM": (piq.srsim, [0.94, 0.98, 0.98, 0.98]),
    "piq MDSI": (piq.mdsi, [0.38, 0.28, 0.28, 0.28]),
    "piqa FSIM": (piqa.FSIM(), [0.87, 0.87, 0.87, 0.96]),
    "piqa MDSI": (piqa.MDSI(), [0.38, 0.38, 0.38, 0.28]),
    "piqa SSIM": (piqa.SSIM(), [0.57] * 4),
    "torchmetrics SSIM": (lambda x, y: tm.structural_similarity_index_measure(x, y, data_range=1.0), [0.57] * 4),
    "kornia SSIM": (lambda x, y: kornia.metrics.ssim(x, y, 11).mean(), [0.57] * 4),
    "pytorch-msssim SSIM": (lambda x, y: pytorch_msssim.ssim(x, y, data_range=1.0), [0.57] * 4),
}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    for name, (score, expected) in scores.items():
        heights = (383, 384, 511, 512)
        found = [float(score(*(image[:, :, :height].contiguous() for image in (picture, noisy)))) for height in heights]
        print(f"{name:20} {np.round(found, 3)}")
        assert np.allclose(found, expected, atol=0.0075), name
assert not caught
PYTHON
echo "as described"
