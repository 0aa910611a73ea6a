#!/usr/bin/env bash
# Pictures as bytes: torchmetrics 1.9.0 finds a mean error of 118 for 4, and FLIP 1.7 one sixteen times smaller.
#
# A picture of 40 to 215, and the same with noise of 5 levels, as they come from a decoder, uint8, and as float32:
#                                                                  uint8       float32
#   torchmetrics, mean_absolute_error                              118         4.0
#                 mean_squared_error                               24.7        25.2; noise of 40: 103 for 1492
#                 image.total_variation, of the noisy one          3080016     1429048
#                 image.image_gradients, mean size                 125         58
#                 image.peak_signal_noise_ratio                    34.1        34.1; so by kornia 0.9.0's
#   flip-evaluator, evaluate(reference, test, "LDR"), 0.1 lighter  0.02        0.30, of [0, 1]
# Bytes wrap: 3 - 5 is 254; FLIP takes 255 for a number far beyond white. Both without a word; SSIM, UQI and others of
# torchmetrics raise. Convert to floats first, for FLIP in [0, 1].
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 kornia==0.9.0 flip-evaluator==1.7 numpy==2.4.6 \
    setuptools==80.9.0
env/bin/python - <<'PYTHON'
import warnings

import flip_evaluator
import kornia
import numpy as np
import torch
from torchmetrics.functional import mean_absolute_error, mean_squared_error
from torchmetrics.functional.image import (
    image_gradients,
    peak_signal_noise_ratio,
    structural_similarity_index_measure,
    total_variation,
)

generator = torch.Generator().manual_seed(0)
picture = torch.randint(40, 216, (1, 3, 64, 64), generator=generator)
noise = torch.randn(picture.shape, generator=generator)
small, large = ((picture + (size * noise).round()).clamp(0, 255) for size in (5, 40))


def flat(score):
    return lambda x, y: score(x.flatten(), y.flatten())


scores = {
    "absolute": flat(mean_absolute_error),
    "squared": flat(mean_squared_error),
    "squared, noise of 40": flat(mean_squared_error),
    "total variation": lambda x, y: total_variation(x),
    "gradients": lambda x, y: torch.stack(image_gradients(x)).float().abs().mean(),
    "PSNR": lambda x, y: peak_signal_noise_ratio(x, y, data_range=255),
    "PSNR by kornia": lambda x, y: kornia.metrics.psnr(x, y, 255.0),
}
found = {}
with warnings.catch_warnings(record=True) as caught:
    warnings.simplefilter("always")
    for name, score in scores.items():
        noisy = large if "40" in name else small
        found[name] = [float(score(noisy.to(kind), picture.to(kind))) for kind in (torch.uint8, torch.float32)]
        print(f"{name:21} bytes {found[name][0]:12.3f}, floats {found[name][1]:12.3f}")
    reference = np.random.default_rng(0).random((32, 32, 3)).astype(np.float32)
    lighter = np.clip(reference + 0.1, 0, 1)
    flips = [
        flip_evaluator.evaluate(convert(reference), convert(lighter), "LDR")[1]
        for convert in (np.copy, lambda x: (255 * x).round().astype(np.uint8))
    ]
print("FLIP of floats and bytes:", np.round(flips, 4))
assert not caught
for name, (low, high), right in (
    ("absolute", (100, 140), 3.993),
    ("squared", (20, 25), 25.154),
    ("squared, noise of 40", (80, 130), 1491.8),
    ("total variation", (2.9e6, 3.3e6), 1429048),
    ("gradients", (110, 140), 58.15),
    ("PSNR", (34.1, 34.15), 34.125),
    ("PSNR by kornia", (34.1, 34.15), 34.125),
):
    assert low < found[name][0] < high and abs(found[name][1] / right - 1) < 0.01
assert abs(flips[0] - 0.302) < 0.005 and abs(flips[1] - 0.019) < 0.003
try:
    structural_similarity_index_measure(small.to(torch.uint8), picture.to(torch.uint8), data_range=255.0)
except RuntimeError as error:
    print("SSIM:", str(error)[:60])
else:
    raise AssertionError("SSIM of bytes")
PYTHON
echo "as described"
