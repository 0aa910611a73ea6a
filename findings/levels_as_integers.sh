#!/usr/bin/env bash
# Pictures of 8 bits in wider integers, as arithmetic leaves them: by scikit-image 0.26.0 any two have the same colours.
#
# Two pictures of random levels, 0 to 255, which differ by 45.6 in CIEDE2000, and the first beside itself with noise of
# 10 levels, whose PSNR is 28.3 dB and SSIM 0.991; all in these types:
#                                                          uint8     uint16    int64, int32     float32
#   scikit-image, rgb2lab and deltaE_ciede2000             45.6      0.32      0.0              92.7
#                 peak_signal_noise_ratio                  28.3      76.5      359.5, 166.8     an error
#                 structural_similarity                    0.991     0.99997   1.0; these three with a warning
#   colour-science 0.4.7, sRGB_to_XYZ, XYZ_to_Lab          a lightness of 6896 for 71 in all
# Integers are divided by the largest of their type, and int64 is what NumPy makes of a list, or of a sum with one.
# No warning but SSIM's. Divide by 255 yourself.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet scikit-image==0.26.0 colour-science==0.4.7 scipy==1.17.1 numpy==2.4.6
env/bin/python - <<'PYTHON'
import warnings

import colour
import numpy as np
from skimage.color import deltaE_ciede2000, rgb2lab
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

random = np.random.default_rng(0)
first, second = random.integers(0, 256, (2, 32, 32, 3))
noisy = np.clip(first + random.normal(0, 10, first.shape), 0, 255).round()
assert first.dtype == np.int64 and (np.array([255, 0]) + np.uint8([0, 1])).dtype == np.int64


def heard(function, *pictures, **options):
    """What a function returns, or the name of its error, and how many warnings it gave."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            return function(*pictures, **options), len(caught)
        except ValueError:
            return None, len(caught)


def difference(x, y):
    return deltaE_ciede2000(rgb2lab(x), rgb2lab(y)).mean()


right = difference(first / 255, second / 255)
assert abs(right - 45.56) < 1 and abs(rgb2lab(first / 255)[0, 0, 0] - rgb2lab(first.astype(np.uint8))[0, 0, 0]) < 1e-9
for kind, apart, decibels, structure in (
    ("uint8", right, 28.3, 0.991),
    ("uint16", 0.32, 76.5, 0.99997),
    ("int64", 0, 359.5, 1),
    ("int32", 0, 166.8, 1),
    ("float32", 92.7, None, None),
):
    x, y, z = (picture.astype(kind) for picture in (first, second, noisy))
    colours, lab_says = heard(difference, x, y)
    psnr, psnr_says = heard(peak_signal_noise_ratio, x, z)
    ssim, ssim_says = heard(structural_similarity, x, z, channel_axis=2)
    lightness = colour.XYZ_to_Lab(colour.sRGB_to_XYZ(x))[0, 0, 0]
    print(f"{kind:8} colours {colours:.4f}, PSNR {psnr}, SSIM {ssim} (warnings {ssim_says}), lightness {lightness:.0f}")
    assert abs(colours - apart) < 1e-2 + 0.03 * apart and lab_says == 0 and psnr_says == 0
    assert lightness > 1000
    assert (psnr, ssim) == (None, None) if decibels is None else abs(psnr - decibels) < 0.5
    assert decibels is None or abs(ssim - structure) < 2e-3 and (ssim_says > 0) == (kind != "uint8")
PYTHON
echo "as described"
