#!/usr/bin/env bash
# three 0.187.0: the zoom of a camera is left out of GLB and USDZ, and so is what lies off the middle.
#
# `OrbitControls` zooms an orthographic camera by `camera.zoom`, and viewers zoom perspective ones by it. What a picture
# shows from top to bottom, by three itself and by a file that it writes, in degrees (or units):
#                                                  three    GLTFExporter      USDZExporter
#   60 degrees, 3:2                                60       60                60
#   the same with zoom = 2                         32.2     60                60
#   60 degrees, 3:2, filmOffset = 5                an axis off the middle; in the middle by both
#   the upper left quarter, by setViewOffset       30       60, the whole     60, the whole
#   orthographic, 2 units high, zoom = 2           1        2                 2
#   orthographic, from 0 to 4 and from 0 to 3      3        6, -3 to 3        3, about the middle
# glTF and USD have room for the zoom, USD for an offset as well. No warning. Before export, give the camera
# `getEffectiveFOV()` as its `fov`, or the sides over the zoom, and zoom = 1. Node.js 22 of npm.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > export.mjs <<'SCRIPT'
import assert from "node:assert";
import * as THREE from "three";
import { GLTFExporter } from "three/examples/jsm/exporters/GLTFExporter.js";
import { USDZExporter } from "three/examples/jsm/exporters/USDZExporter.js";
import { strFromU8, unzipSync } from "three/examples/jsm/libs/fflate.module.js";

for (const name of ["log", "warn", "error"]) {
  const before = console[name];
  console[name] = (...words) => { if (name !== "log") assert.fail("a warning"); before(...words); };
}
const perspective = (aspect) => new THREE.PerspectiveCamera(60, aspect, 0.1, 10);
const orthographic = (...sides) => new THREE.OrthographicCamera(...sides, 0.1, 10);
const cameras = {
  plain: perspective(1.5),
  zoomed: Object.assign(perspective(1.5), { zoom: 2 }),
  shifted: Object.assign(perspective(1.5), { filmOffset: 5 }),
  quarter: perspective(1.5),
  orthographicZoomed: Object.assign(orthographic(-2, 2, 1, -1), { zoom: 2 }),
  orthographicShifted: orthographic(0, 4, 3, 0),
};
cameras.quarter.setViewOffset(600, 400, 0, 0, 300, 200);
const expected = {
  plain: [60, 60, 60, 0],
  zoomed: [32.2, 60, 60, 0],
  shifted: [60, 60, 60, 0.165],
  quarter: [30, 60, 60, -1],
  orthographicZoomed: [1, 2, 2, 0],
  orthographicShifted: [3, 6, 3, -1],
};
const degrees = (half) => (360 / Math.PI) * Math.atan(half);

for (const [name, camera] of Object.entries(cameras)) {
  camera.updateProjectionMatrix();
  const inverse = camera.projectionMatrixInverse;
  const corner = (y) => new THREE.Vector3(0, y, -1).applyMatrix4(inverse);
  const [top, bottom] = [corner(1), corner(-1)];
  const angle = (point) => (180 / Math.PI) * Math.atan(point.y / -point.z);
  const own = camera.isPerspectiveCamera ? angle(top) - angle(bottom) : top.y - bottom.y;
  const shift = camera.projectionMatrix.elements[camera.isPerspectiveCamera ? 8 : 12];

  const scene = new THREE.Scene();
  scene.add(camera);
  const [written] = (await new GLTFExporter().parseAsync(scene)).cameras;
  const gltf = written.type === "perspective"
    ? THREE.MathUtils.radToDeg(written.perspective.yfov) : 2 * written.orthographic.ymag;

  const usda = strFromU8(unzipSync(await new USDZExporter().parseAsync(scene))["model.usda"]);
  const number = (key) => Number(usda.match(new RegExp(`float ${key} = ([\\d.]+)`))[1]);
  const aperture = number("verticalAperture");
  const usd = camera.isPerspectiveCamera ? degrees(aperture / 2 / number("focalLength")) : aperture / 10;
  assert(!usda.includes("ApertureOffset"));

  console.log(`${name.padEnd(20)} three ${own.toFixed(1)}, glTF ${gltf.toFixed(1)}, USDZ ${usd.toFixed(1)};`,
    `off the middle by ${shift.toFixed(3)}`);
  [own, gltf, usd].forEach((value, index) => assert(Math.abs(value - expected[name][index]) < 0.06));
  assert(Math.abs(shift - expected[name][3]) < 0.02);
}
SCRIPT
node_modules/node/bin/node export.mjs
echo "as described"
