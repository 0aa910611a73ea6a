#!/usr/bin/env bash
# An image against itself, half of it white, and against noise: four scores of three packages.
#
# Objects before a white background are usual in this field. Seen, for 128 x 128 pixels of noise (uint8):
#   universal quality index (Wang and Bovik 2002), in [-1, 1], 1 for an image against itself:
#     torchmetrics 1.9.0     0.54 where its right half is white, 0 where all is: windows without contrast count as 0
#     image-similarity-measures 0.3.6, `uiq`     0.53, likewise
#     sewar 0.4.10           1.00; but 0.74 for two unrelated images, 0.92 with half of their contrast (definition: 0.00)
#   spatial correlation coefficient: 0.54 by torchmetrics and sewar
#   spectral angle in degrees, `sam` of image-similarity-measures: 89.5 against itself and against another image, for
#     products of bytes wrap; as float32, 0.0 and 34
#   `issm` of image-similarity-measures: 0 for all of these, a NaN that was replaced
# SSIM, whose constants are there for this, is 1 in all three.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet torch==2.13.0 torchmetrics==1.9.0 setuptools==80.9.0 numpy==2.4.6 sewar==0.4.10
python3 -m venv older  # image-similarity-measures takes NumPy 1
older/bin/pip install --quiet image-similarity-measures==0.3.6 numpy==1.26.4
cat > images.py <<'PYTHON'
import numpy as np

generator = np.random.default_rng(0)
image, other = generator.integers(0, 256, (2, 128, 128, 3), dtype=np.uint8)
half = image.copy()
half[:, 64:] = 255
white = np.full_like(image, 255)
PYTHON
env/bin/python -W ignore - <<'PYTHON'
import sewar
import torch
from images import half, image, other, white
from torchmetrics.functional.image import (
    spatial_correlation_coefficient,
    structural_similarity_index_measure,
    universal_image_quality_index,
)


def by_torchmetrics(score, *images, **options):
    tensors = [torch.from_numpy(one / 255).float().permute(2, 0, 1)[None] for one in images]
    return score(*tensors, **options).item()


uqi, scc = universal_image_quality_index, spatial_correlation_coefficient
found = {
    "torchmetrics uqi, half white": by_torchmetrics(uqi, half, half),
    "torchmetrics uqi, white": by_torchmetrics(uqi, white, white),
    "torchmetrics uqi, unrelated": by_torchmetrics(uqi, image, other),
    "torchmetrics scc, half white": by_torchmetrics(scc, half, half),
    "torchmetrics ssim, half white": by_torchmetrics(structural_similarity_index_measure, half, half, data_range=1.0),
    "sewar uqi, half white": sewar.uqi(half, half),
    "sewar uqi, unrelated": sewar.uqi(image, other),
    "sewar uqi, unrelated, half of the contrast": sewar.uqi(image // 2 + 64, other // 2 + 64),
    "sewar scc, half white": sewar.scc(half, half),
    "sewar ssim, half white": sewar.ssim(half, half)[0],
}
for name, value in found.items():
    print(f"{name}: {value:.2f}")
expected = [0.54, 0, 0, 0.54, 1, 1, 0.74, 0.92, 0.54, 1]
assert all(abs(value - right) < 0.03 for value, right in zip(found.values(), expected, strict=True))
assert by_torchmetrics(uqi, image, image) > 0.999 and by_torchmetrics(scc, image, image) > 0.999
PYTHON
older/bin/python -W ignore - <<'PYTHON'
from image_similarity_measures.quality_metrics import issm, sam, ssim, uiq
from images import half, image, other

found = {
    "uiq, half white": uiq(half, half),
    "sam, itself": sam(image, image),
    "sam, unrelated": sam(image, other),
    "sam, itself, float32": sam(image.astype("float32"), image.astype("float32")),
    "sam, unrelated, float32": sam(image.astype("float32"), other.astype("float32")),
    "issm, itself": issm(image, image),
    "issm, unrelated": issm(image, other),
    "ssim, half white": ssim(half, half),
}
for name, value in found.items():
    print(f"image-similarity-measures {name}: {value:.2f}")
expected = [0.53, 89.5, 89.5, 0, 34.07, 0, 0, 1]
assert all(abs(value - right) < 0.1 for value, right in zip(found.values(), expected, strict=True))
PYTHON
