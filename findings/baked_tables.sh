#!/usr/bin/env bash
# Styles baked to tables by OpenColorIO 2.6.0: a .cube with a shaper is scrambled by ffmpeg and three, a .3dl by ffmpeg.
#
# The style squares red and mixes half of it with half of green, and halves blue: (0.2, 0.6, 0.8) becomes (0.32, 0.6,
# 0.4), which OpenColorIO finds in all of these. `lut3d` of ffmpeg by PyAV 18.1.0, pillow-lut 1.1.0, three 0.187.0,
# colour-science 0.4.7; a dot where it is right, a dash where the format was not tried:
#                                          ffmpeg               pillow-lut    three              colour-science
#   "flame" (.3dl), default, 17 steps      .                    -             raises             -
#           33 steps                       (0.41, 0.82, 0.29)   -             raises             -
#           65 steps                       (0.13, 0.26, 0.23)   -             raises             -
#           9 steps; "lustre" (.3dl)       raises               -             raises             -
#   "iridas_cube", "resolve_cube"          .                    .             .                  .
#   "cinespace" (.csp)                     .                    -             -                  .
#   the same with a shaper, for colours of 0 to 8, as of scenes brighter than white:
#   "cinespace"                            .                    -             -                  .
#   "resolve_cube"                         (1.34, 2.65, 2.23)   raises        1.18, 0.38, 1.91   .
#                                                                             for 0.25, 0.25, 0.38
# Of pillow-lut the size of the table was compared, not its colours. ffmpeg seems to take a .3dl of 33 or 65 steps for
# one of 17 (that it cannot read all such files is known publicly). A .cube with a shaper has 4096 rows before those of
# the table, which three takes for the table's first ones, and by its colours so does ffmpeg. Bake "iridas_cube", or
# "cinespace" for what is brighter than white.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet opencolorio==2.6.0 av==18.1.0 pillow-lut==1.1.0 pillow==13.0.0 colour-science==0.4.7 \
  numpy==2.4.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > tables.py <<'PYTHON'
import json
import warnings
from pathlib import Path

import av
import av.error
import numpy as np
import PyOpenColorIO as ocio
from av.filter import Graph

warnings.simplefilter("ignore")
import colour  # noqa: E402  it tells of optional packages

warnings.simplefilter("error")
from pillow_lut import load_cube_file  # noqa: E402

PLAIN, STYLED, SHAPER = "plain", "styled", "shaper"
config = ocio.Config.CreateRaw()
mixed = ocio.MatrixTransform([0.5, 0.5, 0, 0, 0, 1, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1])
shaped = ocio.GroupTransform([ocio.MatrixTransform([1 / 8, 0, 0, 0, 0, 1 / 8, 0, 0, 0, 0, 1 / 8, 0, 0, 0, 0, 1]),
                              ocio.ExponentTransform([1 / 2.4] * 3 + [1])])
transforms = {PLAIN: None, STYLED: ocio.GroupTransform([ocio.ExponentTransform([2, 1, 1, 1]), mixed]), SHAPER: shaped}
for name, transform in transforms.items():
    space = ocio.ColorSpace(name=name)
    if transform:
        space.setTransform(transform, ocio.COLORSPACE_DIR_FROM_REFERENCE)
    config.addColorSpace(space)


def bake(kind, path, steps=None, shaper=False):
    baker = ocio.Baker()
    baker.setConfig(config)
    baker.setFormat(kind)
    baker.setInputSpace(PLAIN)
    baker.setTargetSpace(STYLED)
    if steps:
        baker.setCubeSize(steps)
    if shaper:
        baker.setShaperSpace(SHAPER)
        baker.setShaperSize(4096)
    Path(path).write_text(baker.bake())


def by_ocio(path, pixels):
    table = ocio.FileTransform(path, interpolation=ocio.INTERP_LINEAR)
    result = np.array(pixels, np.float32)
    ocio.Config.CreateRaw().getProcessor(table).getDefaultCPUProcessor().applyRGB(result)
    return result


def by_ffmpeg(path, pixels):
    pixels = np.asarray(pixels, np.float32)
    frame = av.VideoFrame(len(pixels), 1, "gbrpf32le")
    for plane, channel in zip(frame.planes, (1, 2, 0), strict=True):
        rows = np.zeros(plane.buffer_size, np.uint8)
        line = pixels[:, channel].tobytes()
        rows[:len(line)] = np.frombuffer(line, np.uint8)
        plane.update(rows.tobytes())
    graph = Graph()
    source = graph.add_buffer(width=len(pixels), height=1, format="gbrpf32le", time_base="1/25")
    table, sink = graph.add("lut3d", f"file={path}:interp=trilinear"), graph.add("buffersink")
    source.link_to(table)
    table.link_to(sink)
    graph.configure()
    graph.push(frame)
    result = graph.pull()
    planes = [np.frombuffer(bytes(plane), "<f4")[:len(pixels)] for plane in result.planes]
    return np.stack([planes[2], planes[0], planes[1]], axis=1)


COLOURS = np.array([(0.2, 0.6, 0.8), (0.5, 0.25, 0.75), (1, 1, 1), (0, 0, 0)])
TRUE = np.array([(0.32, 0.6, 0.4), (0.25, 0.25, 0.375), (1, 1, 0.5), (0, 0, 0)])
RIGHT = "right"
CASES = [  # format, ending, steps, shaper; what ffmpeg finds for the first colour
    ("flame", "3dl", None, False, RIGHT),
    ("flame", "3dl", 17, False, RIGHT),
    ("flame", "3dl", 33, False, (0.41, 0.82, 0.29)),
    ("flame", "3dl", 65, False, (0.13, 0.26, 0.23)),
    ("flame", "3dl", 9, False, None),
    ("lustre", "3dl", None, False, None),
    ("lustre", "3dl", 17, False, None),
    ("iridas_cube", "cube", 33, False, RIGHT),
    ("resolve_cube", "cube", 33, False, RIGHT),
    ("cinespace", "csp", 33, False, RIGHT),
    ("cinespace", "csp", 65, True, RIGHT),
    ("resolve_cube", "cube", 65, True, (1.34, 2.65, 2.23)),
]
for kind, ending, steps, shaper, expected in CASES:
    path = f"{kind}_{steps or 'default'}{'_shaper' if shaper else ''}.{ending}"
    bake(kind, path, steps, shaper)
    tolerance = 0.02 if shaper else 0.004
    assert np.abs(by_ocio(path, COLOURS) - TRUE).max() < tolerance, by_ocio(path, COLOURS)
    try:
        found = by_ffmpeg(path, COLOURS)
        print(f"{path}: ffmpeg {found[0].round(3).tolist()}")
        if expected == RIGHT:
            assert np.abs(found - TRUE).max() < tolerance, found
        else:
            assert np.abs(found[0] - expected).max() < 0.02
    except av.error.InvalidDataError as error:
        print(f"{path}: ffmpeg raises {error}")
        assert expected is None
    if ending == "cube" or ending == "csp":
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            read = colour.read_LUT(path)
        assert np.abs(read.apply(COLOURS) - TRUE).max() < tolerance
    if ending == "cube":
        try:
            assert load_cube_file(path).size == (steps,) * 3 and not shaper
        except ValueError as error:
            print(f"{path}: pillow-lut raises {error}")
            assert shaper
bright = by_ocio("cinespace_65_shaper.csp", [(2, 6, 7)])[0]
print(f"(2, 6, 7) by the shaper: {bright}")
assert np.abs(bright - (5, 6, 3.5)).max() < 0.05
PYTHON
env/bin/python tables.py
cat > tables.mjs <<'NODE'
import assert from "node:assert";
import fs from "node:fs";
import { FloatType } from "three";
import { LUT3dlLoader } from "three/examples/jsm/loaders/LUT3dlLoader.js";
import { LUTCubeLoader } from "three/examples/jsm/loaders/LUTCubeLoader.js";

for (const name of fs.readdirSync(".").filter((name) => name.endsWith(".3dl")))
  assert.throws(() => new LUT3dlLoader().parse(fs.readFileSync(name, "utf8")), /grid/, name);
const cube = (name) => {
  const loader = new LUTCubeLoader();
  loader.setType(FloatType);
  const { size, texture3D, domainMin, domainMax } = loader.parse(fs.readFileSync(name, "utf8"));
  const at = (...colour) => {
    const [red, green, blue] = colour.map((value) => Math.round(value * (size - 1)));
    const place = 4 * ((blue * size + green) * size + red);
    return [...texture3D.image.data.slice(place, place + 3)];
  };
  return { at, size, domain: [...domainMin.toArray(), ...domainMax.toArray()] };
};
for (const name of ["iridas_cube_33.cube", "resolve_cube_33.cube"]) {
  const found = cube(name).at(0.5, 0.25, 0.75);
  console.log(`${name}: three ${found}`);
  [0.25, 0.25, 0.375].forEach((value, place) => assert(Math.abs(found[place] - value) < 0.001));
}
const shaper = cube("resolve_cube_65_shaper.cube");
const found = shaper.at(0.5, 0.25, 0.75);
console.log(`with a shaper: three ${found}, of ${shaper.size} steps over ${shaper.domain}`);
assert.deepStrictEqual(shaper.domain, [0, 0, 0, 1, 1, 1]);
assert.strictEqual(shaper.size, 65);
[1.18, 0.38, 1.91].forEach((value, place) => assert(Math.abs(found[place] - value) < 0.01));
// A row of the shaper, which is grey, where the table's row 64 would be red.
const row = shaper.at(1, 0, 0);
console.log(`the row of pure red: ${row}`);
assert(row[0] > 0 && row[0] === row[1] && row[1] === row[2]);
NODE
node_modules/node/bin/node tables.mjs
echo "as described"
