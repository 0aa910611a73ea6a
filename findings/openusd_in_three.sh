#!/usr/bin/env bash
# A stage by OpenUSD 26.11 in three 0.187.0: what is hidden is drawn, points are not, and some meshes lie elsewhere.
#
# `USDLoader` of three reads .usda, .usdc and .usdz. One mesh, or three points, in a file each, as .usda and .usdc:
#                                                          OpenUSD                   three
#   MakeInvisible(); purpose "guide"                       not drawn                 drawn, both
#   Points with colours                                    3 points                  nothing
#   PointInstancer of two places                           two meshes                one, at the origin
#   displayColor, one for each of four corners             four colours              one material, of the first colour
#   rotateZYX of 20, -30, 70 degrees: (1, 0, 0) lies at    (0.30, 0.82, 0.48)        (1, 0, 0), not turned
#   the same by rotateXYZ                                  (0.30, 0.81, 0.50)        right
#   moved by 10.5, turned by 90 degrees about z, moved     (10.5, 1.5, 0)            (10.5, 0, 0): the second move is
#   by 1.5: the origin lies at                                                       left out
#   moved by 1.5 with "resetXformStack" below a parent     (1.5, 0, 0)               (7, 0, 0)
#   that is moved by 5.5: the origin lies at
# Right are a pivot, a quaternion, a matrix, z as the vertical axis, metersPerUnit, and a camera's vertical field. No
# warning. Numbers that are whole, such as a move by (5, 0, 0), are stored shorter in .usdc, where three raises a
# TypeError. For a viewer write one matrix for each mesh (`MakeMatrixXform`), points as glTF, nothing that is hidden.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet usd-core==26.11
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > write.py <<'PYTHON'
import json

from pxr import Gf, Usd, UsdGeom

TURN = (20, -30, 70)
truth = {}


def mesh(stage, path):
    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 2, 0), (0, 0, 3)])
    made.CreateFaceVertexCountsAttr([3, 3, 3, 3])
    made.CreateFaceVertexIndicesAttr([0, 2, 1, 0, 1, 3, 0, 3, 2, 1, 2, 3])
    return made


def hidden(stage):
    mesh(stage, "/m").MakeInvisible()


def guide(stage):
    mesh(stage, "/m").CreatePurposeAttr("guide")


def points(stage):
    made = UsdGeom.Points.Define(stage, "/m")
    made.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (0, 2, 0)])
    made.CreateDisplayColorPrimvar("vertex").Set([(1, 0, 0), (0, 1, 0), (0, 0, 1)])


def instances(stage):
    made = UsdGeom.PointInstancer.Define(stage, "/i")
    mesh(stage, "/i/m")
    made.CreatePrototypesRel().SetTargets(["/i/m"])
    made.CreatePositionsAttr([(2.5, 0, 0), (5.5, 0, 0)])
    made.CreateProtoIndicesAttr([0, 0])
    count = len(made.ComputeInstanceTransformsAtTime(Usd.TimeCode.Default(), Usd.TimeCode.Default()))
    print("instances by OpenUSD:", count)
    assert count == 2


def colours(stage):
    mesh(stage, "/m").CreateDisplayColorPrimvar("vertex").Set([(1, 0, 0), (0, 0.5, 0), (0, 0, 1), (1, 1, 1)])


def zyx(stage):
    mesh(stage, "/m").AddRotateZYXOp().Set(TURN)


def xyz(stage):
    mesh(stage, "/m").AddRotateXYZOp().Set(TURN)


def moves(stage):
    made = mesh(stage, "/m")
    made.AddTranslateOp().Set((10.5, 0, 0))
    made.AddRotateZOp().Set(90)
    made.AddTranslateOp(opSuffix="second").Set((1.5, 0, 0))


def reset(stage):
    UsdGeom.Xform.Define(stage, "/p").AddTranslateOp().Set((5.5, 0, 0))
    made = mesh(stage, "/p/m")
    made.AddTranslateOp().Set((1.5, 0, 0))
    made.SetResetXformStack(True)


def pivot(stage):
    made = UsdGeom.XformCommonAPI(mesh(stage, "/m"))
    made.SetTranslate((10.5, 0, 0))
    made.SetRotate((0, 0, 90))
    made.SetPivot((1.5, 0, 0))


def quaternion(stage):
    mesh(stage, "/m").AddOrientOp().Set(Gf.Quatf(0.5, 0.5, 0.5, 0.5))


def matrix(stage):
    turned = Gf.Matrix4d().SetRotate(Gf.Rotation((0, 0, 1), 90))
    mesh(stage, "/m").AddTransformOp().Set(turned * Gf.Matrix4d().SetTranslate((1, 2, 3)))


def vertical(stage):
    UsdGeom.SetStageUpAxis(stage, "Z")
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    mesh(stage, "/m")


def camera(stage):
    made = UsdGeom.Camera.Define(stage, "/m")
    made.CreateFocalLengthAttr(50.5)
    made.CreateHorizontalApertureAttr(36.5)
    made.CreateVerticalApertureAttr(24.5)


def whole(stage):
    mesh(stage, "/m").AddTranslateOp().Set((5, 0, 0))


CASES = (hidden, guide, points, instances, colours, zyx, xyz, moves, reset, pivot, quaternion, matrix, vertical, camera,
         whole)
for case in CASES:
    for ending in ("usda", "usdc"):
        stage = Usd.Stage.CreateNew(f"{case.__name__}.{ending}")
        UsdGeom.SetStageUpAxis(stage, "Y")
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        case(stage)
        stage.Save()
    cache = UsdGeom.XformCache(Usd.TimeCode.Default())
    prim = next(prim for prim in stage.Traverse() if prim.GetName() == "m")
    world = cache.GetLocalToWorldTransform(prim)
    truth[case.__name__] = [list(world.Transform(Gf.Vec3d(*corner))) for corner in ((0, 0, 0), (1, 0, 0))]
    if case is hidden:
        assert UsdGeom.Imageable(prim).ComputeVisibility() == "invisible"
    if case is guide:
        drawn = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
        assert drawn.ComputeWorldBound(stage.GetPseudoRoot()).GetRange().IsEmpty()
    if case is camera:
        truth["field"] = UsdGeom.Camera(prim).GetCamera().GetFieldOfView(Gf.Camera.FOVVertical)
json.dump(truth, open("truth.json", "w"))
PYTHON
env/bin/python write.py
cat > read.mjs <<'NODE'
import assert from "node:assert";
import fs from "node:fs";
import { Vector3 } from "three";
import { USDLoader } from "three/examples/jsm/loaders/USDLoader.js";

const said = [];
for (const kind of ["warn", "error"]) console[kind] = (...words) => said.push(words.join(" "));
const truth = JSON.parse(fs.readFileSync("truth.json", "utf8"));
const load = (name, ending) => {
  const file = fs.readFileSync(`${name}.${ending}`);
  const bytes = file.buffer.slice(file.byteOffset, file.byteOffset + file.length);
  const group = new USDLoader().parse(ending === "usda" ? file.toString() : bytes);
  group.updateMatrixWorld(true);
  const found = [];
  group.traverse((object) => {
    if (object.isMesh || object.isPoints || object.isCamera) found.push(object);
  });
  return found;
};
// Where the corners (0, 0, 0) and (1, 0, 0) of the mesh lie.
const corners = (mesh) =>
  [[0, 0, 0], [1, 0, 0]].map((corner) => new Vector3(...corner).applyMatrix4(mesh.matrixWorld).toArray());
const near = (one, other) => one.flat().every((value, place) => Math.abs(value - other.flat()[place]) < 1e-4);
const shown = (places) => places.map((place) => `(${place.map((value) => value.toFixed(2)).join(", ")})`).join(" ");

for (const ending of ["usda", "usdc"]) {
  for (const name of ["hidden", "guide"]) {
    const [mesh] = load(name, ending);
    console.log(`${ending} ${name}: visible ${mesh.visible}`);
    let object = mesh;
    for (; object; object = object.parent) assert(object.visible);
  }
  assert.strictEqual(load("points", ending).length, 0);
  const instances = load("instances", ending);
  console.log(`${ending} instances: ${instances.length}, ${shown(corners(instances[0]))}`);
  assert(instances.length === 1 && !instances[0].isInstancedMesh);
  assert(near(corners(instances[0]), [[0, 0, 0], [1, 0, 0]]));
  const [coloured] = load("colours", ending);
  console.log(`${ending} colours: ${coloured.material.color.toArray()}`);
  assert(!coloured.geometry.attributes.color && !Array.isArray(coloured.material));
  assert.deepStrictEqual(coloured.material.color.toArray(), [1, 0, 0]);
  for (const name of ["zyx", "xyz", "moves", "reset", "pivot", "quaternion", "matrix"]) {
    const found = corners(load(name, ending)[0]);
    console.log(`${ending} ${name}: ${shown(truth[name])}, three ${shown(found)}`);
    assert.strictEqual(near(found, truth[name]), !["zyx", "moves", "reset"].includes(name), name);
    if (name === "zyx") assert(near(found, [[0, 0, 0], [1, 0, 0]]));
    if (name === "moves") assert(near([truth.moves[0], found[0]], [[10.5, 1.5, 0], [10.5, 0, 0]]));
    if (name === "reset") assert(near([truth.reset[0], found[0]], [[1.5, 0, 0], [7, 0, 0]]));
  }
  const [flat] = load("vertical", ending);
  flat.geometry.computeBoundingBox();
  const box = flat.geometry.boundingBox.clone().applyMatrix4(flat.matrixWorld);
  console.log(`${ending} vertical: ${box.min.toArray()} to ${box.max.toArray()}`);
  assert(near([box.max.toArray()], [[0.01, 0.03, 0]]) && near([box.min.toArray()], [[0, 0, -0.02]]));
  const [camera] = load("camera", ending);
  console.log(`${ending} camera: ${camera.fov}, OpenUSD ${truth.field}`);
  assert(Math.abs(camera.fov - truth.field) < 1e-3);
}
const rounded = (place) => place.map((value) => +value.toFixed(2));
assert.deepStrictEqual([rounded(truth.zyx[1]), rounded(truth.xyz[1])], [[0.3, 0.82, 0.48], [0.3, 0.81, 0.5]]);
assert(near(corners(load("whole", "usda")[0]), truth.whole));
assert.throws(() => load("whole", "usdc"), TypeError);
console.log(`said: ${said.length}`);
assert.strictEqual(said.length, 0);
NODE
node_modules/node/bin/node read.mjs
echo "as described"
