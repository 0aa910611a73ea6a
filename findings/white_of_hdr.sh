#!/usr/bin/env bash
# Films of high dynamic range, brought to SDR by ffmpeg: what white, grey and three colours become.
#
# Patches of sRGB with white at 203 cd/m² (ITU-R BT.2408), stored by ITU-R BT.2100's formulas as PQ and as HLG (1,000
# cd/m²) in BT.2020, Y'CbCr 4:4:4 of 10 bits. ffmpeg 9.0.2 (imageio-ffmpeg 0.8.0), levels of 255:
#                                    white  grey   (200, 80, 40)      (60, 120, 200)     (20, 60, 30)
#   nothing, as readers do, PQ        149    109   (124, 95, 70)      (95, 105, 132)     (60, 74, 56)
#                           HLG       192    121   (157, 89, 49)      (89, 112, 174)     (42, 62, 38)
#   zscale, tonemap=hable:desat=0,
#   npl=100, as most recipes, PQ      194    119   (166, 73, 42)      (58, 104, 167)     (30, 64, 38)
#                           HLG       193    119   (175, 64, 30)      (39, 101, 178)     (20, 66, 35)
#   zscale, tonemap=clip, npl=203, PQ 255    129   (202, 81, 40)      (62, 121, 201)     (21, 61, 31)
#                           HLG       255    128   (218, 70, 24)      (39, 121, 223)     ( 8, 62, 27)
#   scale=out_transfer=...   PQ       254    128   (205, 82, 36)      (58, 124, 206)     (18, 56, 29)
#   (its default intent)    HLG       255    129   (205, 82, 35)      (58, 124, 206)     (18, 56, 29)
#   the same, of RGB of 16 bits, both 255    128   (201, 81, 40)      (61, 120, 200)     (20, 60, 30)
#   scale, intent=perceptual, PQ      150     89   (139, 59, 25)      (41, 86, 141)      (12, 38, 18)
#                           HLG       169    102   (164, 70, 31)      (47, 99, 162)      (15, 46, 23)
# The usual recipe leaves white at 194: it keeps room for highlights, whether there are any or not. zscale is right on
# PQ and too saturated on HLG, whose system gamma it applies to each channel (closed form: 217 70 25, 38 120 220) where
# BT.2100 applies it to luminance, so that one scene has other colours by the film's curve. Convert to RGB first, then
# by `scale`, which clips; it is within a level.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet imageio-ffmpeg==0.8.0 numpy==2.4.6
env/bin/python - 2> log.txt <<'PYTHON'
import subprocess

import imageio_ffmpeg
import numpy as np

COLORS = np.array([[255, 255, 255], [128, 128, 128], [200, 80, 40], [60, 120, 200], [20, 60, 30]])
WIDE = np.array([[0.6274, 0.3293, 0.0433], [0.0691, 0.9195, 0.0114], [0.0164, 0.0880, 0.8956]])
CURVES = {"PQ": "smpte2084", "HLG": "arib-std-b67"}


def stored(curve):
    srgb = COLORS / 255
    light = 203 * np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4) @ WIDE.T
    if curve == "PQ":
        power = (light / 10_000) ** (2610 / 16384)
        return ((3424 + 2413 * 32 * power) / 4096 / (1 + 2392 * 32 / 4096 * power)) ** (2523 / 4096 * 128)
    scene = light / 1000 * (light @ [0.2627, 0.6780, 0.0593] / 1000)[:, None] ** (1 / 1.2 - 1)
    bright = 0.17883277 * np.log(np.maximum(12 * scene, 1) - 0.28466892) + 0.55991073
    return np.where(scene <= 1 / 12, np.sqrt(3 * scene), bright)


def shown(curve, chain):
    pixels = (65535 * stored(curve)).round().astype(np.uint16)[None].repeat(32, 0).repeat(32, 1)
    tags = f"setparams=color_primaries=bt2020:color_trc={CURVES[curve]}"
    film = f"{tags}:range=pc:colorspace=gbr,scale=out_color_matrix=bt2020nc:out_range=tv,format=yuv444p10le"
    graph = f"{film},{tags}:range=tv:colorspace=bt2020nc,{chain}"
    raw = ("-f", "rawvideo", "-pix_fmt")
    command = [imageio_ffmpeg.get_ffmpeg_exe(), "-v", "error", *raw, "rgb48le", "-s", "160x32", "-i", "-", "-vf", graph]
    done = subprocess.run([*command, *raw, "rgb24", "-"], input=pixels.tobytes(), capture_output=True, check=True)
    return np.frombuffer(done.stdout, np.uint8).reshape(32, 160, 3)[16, 16::32].astype(int)


RGB = "scale=flags=accurate_rnd+full_chroma_int,format=rgb24"
SRGB = "scale=out_transfer=iec61966-2-1:out_primaries=bt709:out_range=full"


def by_zscale(npl, curve, transfer):
    linear = f"zscale=t=linear:npl={npl},format=gbrpf32le,zscale=p=bt709,tonemap=tonemap={curve}:desat=0"
    return f"{linear},zscale=t={transfer}:m=bt709:r=tv,format=yuv444p,{RGB}"


CHAINS = {
    "nothing": (RGB, [[124, 95, 70], [95, 105, 132]], [[157, 89, 49], [89, 112, 174]], (149, 192)),
    "hable": (by_zscale(100, "hable", "bt709"), [[166, 73, 42], [58, 104, 167]], [[175, 64, 30], [39, 101, 178]], (194, 193)),
    "clip": (by_zscale(203, "clip", "iec61966-2-1"), [[202, 81, 40], [62, 121, 201]], [[218, 70, 24], [39, 121, 223]], (255, 255)),
    "scale": (f"{SRGB},format=rgb24", [[205, 82, 36], [58, 124, 206]], [[205, 82, 35], [58, 124, 206]], (254, 255)),
    "RGB, scale": (f"scale=flags=accurate_rnd+full_chroma_int,format=gbrp16le,{SRGB},format=rgb24",
                   [[200, 80, 40], [60, 120, 200]], [[200, 80, 40], [60, 120, 200]], (255, 255)),
    "perceptual": (f"{SRGB}:intent=perceptual,format=rgb24", [[139, 59, 25], [41, 86, 141]], [[164, 70, 31], [47, 99, 162]], (150, 169)),
}
for name, (chain, *expected, whites) in CHAINS.items():
    for curve, colors, white in zip(CURVES, expected, whites, strict=True):
        found = shown(curve, chain)
        print(f"{name:11} {curve:4}", *found.tolist())
        assert np.abs(found[2:4] - colors).max() <= 2 and np.abs(found[0] - white).max() <= 2
PYTHON
echo "as described"
