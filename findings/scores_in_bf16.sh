#!/usr/bin/env bash
# Scores within bf16 autocast, as where validation runs in `bf16-mixed`: SSIM calls the worse of two renders better.
#
# PyTorch 2.13.0. A light picture of soft colours (0.6 to 1), and renders of it with noise of 0.003, 0.01 and 0.03:
#                                                      as floats                in autocast
#   torchmetrics 1.9.0, SSIM                           0.996  0.958  0.731      0.58   0.88   0.82
#                       multi-scale SSIM               1.000  0.996  0.972      0.95   1.005  1.055
#                       universal quality index        0.990  0.913  0.607      0.18   0.23   0.24
#                       visual information fidelity    0.955  0.751  0.438      0.89   0.73   0.58
#   pytorch-msssim 1.0.0, SSIM                         0.996  0.959  0.734      1.12   1.18   1.07
#   kornia 0.9.0, metrics.ssim; PSNR by torchmetrics   the same in both
# Their convolutions round to eight bits, and a variance is a difference of two of these. The result of most has the
# type float32, and nothing is said. Lightning runs `validation_step` in the precision of training. Take scores in
# `torch.autocast(device_type, enabled=False)`, of pictures that are float32.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 kornia==0.9.0 pytorch-msssim==1.0.0 numpy==2.4.6 \
    setuptools==80.9.0
env/bin/python - <<'PYTHON'
import warnings

import kornia
import pytorch_msssim
import torch
from torchmetrics.functional.image import (
    multiscale_structural_similarity_index_measure,
    peak_signal_noise_ratio,
    structural_similarity_index_measure,
    universal_image_quality_index,
    visual_information_fidelity,
)

generator = torch.Generator().manual_seed(0)
coarse = torch.rand(1, 3, 24, 24, generator=generator)
picture = (torch.nn.functional.interpolate(coarse, (192, 192), mode="bicubic") * 0.3 + 0.65).clamp(0, 1)
noise = torch.randn(picture.shape, generator=generator)
scores = {
    "SSIM": lambda x, y: structural_similarity_index_measure(x, y, data_range=1.0),
    "multi-scale": lambda x, y: multiscale_structural_similarity_index_measure(
        x, y, data_range=1.0, betas=(0.0448, 0.2856, 0.3001)
    ),
    "UQI": universal_image_quality_index,
    "VIF": lambda x, y: visual_information_fidelity(x * 255, y * 255),
    "pytorch-msssim": lambda x, y: pytorch_msssim.ssim(x, y, data_range=1.0),
    "kornia": lambda x, y: kornia.metrics.ssim(x, y, 11).mean(),
    "PSNR": lambda x, y: peak_signal_noise_ratio(x, y, data_range=1.0),
}
found = {}
for name, score in scores.items():
    for mixed in (False, True):
        values = []
        for size in (0.003, 0.01, 0.03):
            render = (picture + size * noise).clamp(0, 1)
            with warnings.catch_warnings(record=True) as caught, torch.autocast("cpu", torch.bfloat16, enabled=mixed):
                warnings.simplefilter("always")
                values.append(score(render, picture))
            assert not caught
        found[name, mixed] = [float(value) for value in values]
        print(f"{name:15} {('floats', 'autocast')[mixed]:9}", [f"{v:.3f}" for v in found[name, mixed]], values[0].dtype)
floats = {name: found[name, False] for name in scores}
mixed = {name: found[name, True] for name in scores}
for name in floats:
    assert floats[name][0] > floats[name][1] > floats[name][2]
for name in ("kornia", "PSNR"):
    assert all(abs(a - b) < 1e-3 for a, b in zip(floats[name], mixed[name]))
assert mixed["SSIM"][0] < mixed["SSIM"][2] - 0.1 and mixed["SSIM"][0] < floats["SSIM"][0] - 0.2
assert max(mixed["multi-scale"]) > 1.01 and max(mixed["UQI"]) < 0.5
assert mixed["VIF"][0] < floats["VIF"][0] - 0.03 and mixed["VIF"][2] > floats["VIF"][2] + 0.05
assert max(mixed["pytorch-msssim"]) > 1.02
PYTHON
echo "as described"
