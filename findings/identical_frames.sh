#!/usr/bin/env bash
# ffmpeg-quality-metrics 3.13.0: a film without loss has a PSNR of 0.0, and frames without loss are left out of others.
#
# 40 frames of a moving test picture, losslessly, and the same with noise in some of them. PSNR in dB, by the filter of
# ffmpeg 9.0.2 (imageio-ffmpeg 0.8.1) and as `psnr_avg` of the package, which runs that filter:
#                                          ffmpeg     average, lowest, highest of    MSE      SSIM
#                                                     the package
#   noise in all 40 frames                 23.7       23.7   23.7   23.7             278      0.37
#   in the last 20                         26.7       23.7   23.7   23.7             139      0.69
#   in the last 10                         29.7       23.7   23.7   23.7             69       0.84
#   in the last one                        39.7       23.7   23.7   23.7             7        0.98
#   in none: a copy, bit for bit           inf        0.0    0.0    0.0              0        1.00
# Frames that are equal have an infinite PSNR and are dropped before the mean, as in a film whose background stands
# still, or that begins with a title; where none is left the result is zero, the worst there is. It says nothing.
# Take the mean of the MSE, 10 log10(255^2 / MSE), or the rows of each frame, in which infinity is kept.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet ffmpeg-quality-metrics==3.13.0 imageio-ffmpeg==0.8.1
env/bin/python - 2> log.txt <<'PYTHON'
import math
import re
import subprocess

import imageio_ffmpeg
from ffmpeg_quality_metrics import FfmpegQualityMetrics

FFMPEG = imageio_ffmpeg.get_ffmpeg_exe()
assert "9.0.2" in imageio_ffmpeg.get_ffmpeg_version(), imageio_ffmpeg.get_ffmpeg_version()
SOURCE = ("-f", "lavfi", "-i", "testsrc2=size=320x240:rate=10:duration=4")


def film(name, *filters):
    command = [FFMPEG, "-loglevel", "error", *SOURCE, *filters, "-c:v", "ffv1", name]
    subprocess.run(command, check=True)


def by_ffmpeg(name):
    command = [FFMPEG, "-i", name, "-i", "truth.mkv", "-lavfi", "psnr", "-f", "null", "-"]
    said = subprocess.run(command, capture_output=True, text=True, check=True).stderr
    return float(re.search(r"PSNR .*average:(\S+)", said)[1])


film("truth.mkv")
EXPECTED = {40: (23.7, 23.7, 278, 0.37), 20: (26.7, 23.7, 139, 0.69), 10: (29.7, 23.7, 69, 0.84),
            1: (39.7, 23.7, 7, 0.98), 0: (math.inf, 0.0, 0, 1.0)}
for noisy, (filtered, average, error, ssim) in EXPECTED.items():
    name = f"noisy_{noisy}.mkv"
    film(name, *(("-vf", f"noise=alls=30:allf=t:enable='gte(n,{40 - noisy})'") if noisy else ()))
    metrics = FfmpegQualityMetrics("truth.mkv", name, ffmpeg_path=FFMPEG)
    frames = metrics.calculate(["psnr", "ssim"])["psnr"]
    found = metrics.get_global_stats()
    psnr, mse = found["psnr"]["psnr_avg"], found["psnr"]["mse_avg"]
    print(f"{noisy} noisy: ffmpeg {by_ffmpeg(name):.2f}, package {psnr}")
    print(f"    MSE {mse['average']}, SSIM {found['ssim']['ssim_avg']['average']}")
    assert abs(by_ffmpeg(name) - filtered) < 0.06 or by_ffmpeg(name) == filtered
    assert all(abs(psnr[name] - average) < 0.06 for name in ("average", "median", "min", "max"))
    assert abs(mse["average"] - error) < 1 and abs(found["ssim"]["ssim_avg"]["average"] - ssim) < 0.006
    assert sum(math.isinf(frame["psnr_avg"]) for frame in frames) == 40 - noisy and len(frames) == 40
    if noisy:
        assert abs(10 * math.log10(255 ** 2 / mse["average"]) - by_ffmpeg(name)) < 0.05
PYTHON
if grep -v "ffprobe not found" log.txt; then exit 1; fi
echo "as described"
