#!/usr/bin/env bash
# torchmetrics 1.9.0, three scores of ordinary pictures: one is 64 times too large, one NaN, one minus thirteen billion.
#
# A picture of 64 x 64 pixels in levels of 8 bits, and the same with noise of 20 levels; sewar 0.4.10 beside.
#   relative average spectral error (RASE)    949; sewar 14.8. Means of windows are divided by their pixels once more:
#                                             16, 64 and 256 times too large for windows of 4, 8 and 16
#   spectral angle (SAM)                      0.108; NaN as soon as one pixel of one picture is black, and with it the
#                                             mean over an evaluation; sewar leaves such a pixel out, 0.108
#   universal quality index, in [-1, 1]       0.97; with a white third in both -1.3e10: what rounding leaves of a
#                                             covariance is divided by an epsilon. -4.4e9 in double precision; 0.72 of
#                                             pictures in [0, 1], and 0.95 in double precision; sewar 0.99
# No warning. SSIM is 0.97 and 0.98.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 sewar==0.4.10 scipy==1.17.1 numpy==2.4.6 setuptools==80.9.0
env/bin/python - <<'PYTHON'
import warnings

import numpy as np
import sewar
import torch
import torchmetrics.functional.image as scores
from torchmetrics.image import SpectralAngleMapper

random = np.random.default_rng(0)
target = random.integers(1, 256, (64, 64, 3)).astype(float)
noisy = np.clip(target + random.normal(0, 20, target.shape), 1, 255).round()


def tensor(image, precision=torch.float32):
    return torch.tensor(image, dtype=precision).permute(2, 0, 1)[None]


def levels(*images):
    return [image.astype(np.uint8) for image in images]


true = 100 / target.mean() * np.sqrt(((noisy - target) ** 2).mean())
for window in (4, 8, 16):
    rase = float(scores.relative_average_spectral_error(tensor(noisy), tensor(target), window_size=window))
    beside = float(sewar.rase(*levels(target, noisy), ws=window))
    print(f"RASE, window {window}: {rase:.1f}, sewar {beside:.2f}, {rase / beside:.1f} times; of the whole {true:.2f}")
    assert abs(rase / beside - window**2) < 0.1 and abs(beside - true) < 1

with warnings.catch_warnings():
    warnings.simplefilter("error")
    black = target.copy()
    black[5, 5] = 0
    for name, pair in (("target", (noisy, black)), ("prediction", (black, target)), ("neither", (noisy, target))):
        angle = float(scores.spectral_angle_mapper(*map(tensor, pair)))
        print(f"SAM, a black pixel in {name}: {angle:.3f}")
        assert np.isnan(angle) == (name != "neither")
    assert abs(angle - 0.108) < 0.001
    metric = SpectralAngleMapper()
    for clean in (target, black, target):
        metric.update(tensor(noisy), tensor(clean))
    assert torch.isnan(metric.compute())
beside = float(sewar.sam(*levels(black, noisy)))
print(f"SAM, sewar: {beside:.3f}")
assert abs(beside - 0.108) < 0.001

white = [image.copy() for image in (noisy, target)]
for image in white:
    image[:, 40:] = 255
for name, pair in (("noise", (noisy, target)), ("a white third", white)):
    found = {
        f"{precision}, of {top}": float(
            scores.universal_image_quality_index(*(tensor(image / (255 / top), precision) for image in pair))
        )
        for precision in (torch.float32, torch.float64)
        for top in (255, 1)
    }
    ssim = float(scores.structural_similarity_index_measure(*map(tensor, pair), data_range=255.0))
    beside = float(sewar.uqi(*levels(pair[1], pair[0])))
    print(f"{name}: {found}, SSIM {ssim:.2f}, sewar {beside:.2f}")
    if name == "noise":
        assert all(abs(value - 0.966) < 0.002 for value in found.values()) and abs(ssim - 0.966) < 0.002
    else:
        whole, unit, whole_double, unit_double = found.values()
        assert whole < -1e9 and whole_double < -1e9 and abs(unit - 0.72) < 0.01 and abs(unit_double - 0.95) < 0.01
        assert abs(ssim - 0.979) < 0.002 and abs(beside - 0.995) < 0.002
PYTHON
echo "as described"
