#!/usr/bin/env bash
# A style as a .cube table whose domain is not 0 to 1: pillow-lut leaves the domain out, ffmpeg reads half of it.
#
# DOMAIN_MIN and DOMAIN_MAX say which colours the first and last rows stand for, beyond 0 and 1 for grades of scenes
# that are brighter than white; the format leaves the order of its keywords open. The table halves every colour, which
# is linear, so that no grid can be to blame: (0.2, 0.6, 0.8) should become (0.1, 0.3, 0.4).
#   domain                                   0 to 1    0 to 2           -1 to 1
#   colour-science 0.4.7, OpenColorIO 2.6.0  right     right            right
#   ffmpeg, PyAV 18.1.0, `lut3d`, domain after LUT_3D_SIZE
#                                            right     right            0, 0, 0
#           domain before LUT_3D_SIZE        right     0.2, 0.6, 0.8    0, 0.1, 0.3
#   pillow-lut 1.1.0, either order           right     0.2, 0.6, 0.8    0, 0.1, 0.3
# With Resolve's LUT_3D_INPUT_RANGE 0 2 in its place the first two are right, pillow-lut has 0.2, 0.6, 0.8, and ffmpeg
# raises. No warning. Write tables for 0 to 1 alone, or read them by colour-science or OpenColorIO.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet colour-science==0.4.7 opencolorio==2.6.0 av==18.1.0 pillow-lut==1.1.0 pillow==12.3.0 \
    numpy==2.4.6 scipy==1.17.1
env/bin/python - <<'PYTHON'
import itertools
import warnings
from pathlib import Path

import av
import numpy as np
import pillow_lut
import PyOpenColorIO
from PIL import Image

with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    import colour
COLOUR = np.array([0.2, 0.6, 0.8])
BYTES = np.round(255 * COLOUR).astype(np.uint8)
av.logging.set_level(av.logging.PANIC)


def write(name, low, high, head, after):
    steps = np.linspace(low, high, 3)
    rows = [f"{r / 2:f} {g / 2:f} {b / 2:f}" for b, g, r in itertools.product(steps, repeat=3)]
    Path(name).write_text("\n".join([*head, "LUT_3D_SIZE 3", *after, *rows, ""]))


def by_colour(name):
    return colour.read_LUT(name).apply(COLOUR)


def by_ocio(name):
    transform = PyOpenColorIO.FileTransform(name, interpolation=PyOpenColorIO.INTERP_LINEAR)
    processor = PyOpenColorIO.Config.CreateRaw().getProcessor(transform).getDefaultCPUProcessor()
    return processor.applyRGB(COLOUR.tolist())


def by_ffmpeg(name):
    graph = av.filter.Graph()
    source = graph.add_buffer(width=16, height=16, format="rgb24", time_base="1/25")
    table, sink = graph.add("lut3d", name), graph.add("buffersink")
    source.link_to(table)
    table.link_to(sink)
    graph.configure()
    graph.push(av.VideoFrame.from_ndarray(np.broadcast_to(BYTES, (16, 16, 3)).copy(), format="rgb24"))
    return graph.pull().to_ndarray(format="rgb24")[8, 8] / 255


def by_pillow(name):
    picture = Image.new("RGB", (1, 1), tuple(BYTES.tolist()))
    return np.array(picture.filter(pillow_lut.load_cube_file(name)))[0, 0] / 255


def domain(low, high):
    return [f"DOMAIN_MIN {low} {low} {low}", f"DOMAIN_MAX {high} {high} {high}"]


right = (0.1, 0.3, 0.4)
same, cut = (0.2, 0.6, 0.8), (0, 0.1, 0.3)
for name, low, high, head, after, expected in (
    ("unit.cube", 0, 1, domain(0, 1), [], (right, right, right, right)),
    ("bright_after.cube", 0, 2, [], domain(0, 2), (right, right, right, same)),
    ("bright_before.cube", 0, 2, domain(0, 2), [], (right, right, same, same)),
    ("signed_after.cube", -1, 1, [], domain(-1, 1), (right, right, (0, 0, 0), cut)),
    ("signed_before.cube", -1, 1, domain(-1, 1), [], (right, right, cut, cut)),
    ("range.cube", 0, 2, [], ["LUT_3D_INPUT_RANGE 0 2"], (right, right, None, same)),
):
    write(name, low, high, head, after)
    for way, wanted in zip((by_colour, by_ocio, by_ffmpeg, by_pillow), expected):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            try:
                found = np.asarray(way(name), float)
            except Exception as error:
                found = None
                print(f"{name:18} {way.__name__:10} {type(error).__name__}")
        assert (found is None) == (wanted is None) and not caught, (name, way.__name__, found, caught)
        if found is not None:
            print(f"{name:18} {way.__name__:10} {np.round(found, 2)}")
            assert np.allclose(found, wanted, atol=0.005)
PYTHON
echo "as described"
