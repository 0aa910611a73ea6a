#!/usr/bin/env bash
# Colours of points in PCD: pypcd4 1.5.1 writes them as black into text, pyntcloud 0.3.1 reads Open3D's as others.
#
# Three points, (255, 128, 0), (1, 2, 3) and (200, 255, 254), written and read by each; the first of them:
#                                         read by Open3D      pypcd4            pyntcloud         three
#                                         0.20.0, both halves                                     0.187.0
#   Open3D, binary                        right               right             127, 128, 0       right
#           text, io; t.io                right; right        right; raises     127, 128, 0;      right
#                                                                               raises
#   pypcd4, binary                        right               right             right             right
#           compressed                    right               right             raises            right
#           text, Encoding.ASCII          black               black             black             black
# PCD packs a colour into four bytes, whose type is float by PCL's custom, as pypcd4 has it, or unsigned, as Open3D has
# it. As a float it is 2.3e-38, and pypcd4 writes ten digits behind the point. pyntcloud takes the number of an unsigned
# colour for a float and unpacks that one's bytes: (1, 2, 3) becomes (129, 1, 128). No warning. (That PCL's own text
# rounds colours is known publicly.) Let pypcd4 write its default, binary; for pyntcloud write PLY.
set -euo pipefail
cd "$(mktemp -d)"
trap "rm -rf '$PWD'" EXIT
python3 -m venv env
env/bin/pip install --quiet open3d==0.20.0 pypcd4==1.5.1 pyntcloud==0.3.1 pandas==3.0.6 numpy==2.2.6
npm init -y > npm.log
npm install --no-fund --no-audit --silent node@22.23.3 three@0.187.0
cat > colours.py <<'PYTHON'
import warnings

warnings.filterwarnings("error", category=UserWarning)
import numpy as np
import open3d as o3d
from pyntcloud import PyntCloud
from pypcd4 import Encoding, PointCloud

places = np.array([[0, 0, 0], [1, 0.5, 0.25], [2.125, -3, 4]], np.float32)
colours = np.array([[255, 128, 0], [1, 2, 3], [200, 255, 254]], np.uint8)
OTHERS = [[127, 128, 0], [129, 1, 128], [72, 255, 254]]

cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(places))
cloud.colors = o3d.utility.Vector3dVector(colours / 255)
tensors = o3d.t.geometry.PointCloud(o3d.core.Tensor(places))
tensors.point.colors = o3d.core.Tensor(colours)
packed = PointCloud.encode_rgb(colours)
points = PointCloud.from_xyzrgb_points(np.column_stack([places, packed]).astype(np.float32))
WRITE = {
    "open3d_binary": lambda name: o3d.io.write_point_cloud(name, cloud),
    "open3d_text": lambda name: o3d.io.write_point_cloud(name, cloud, write_ascii=True),
    "tensor_binary": lambda name: o3d.t.io.write_point_cloud(name, tensors),
    "tensor_text": lambda name: o3d.t.io.write_point_cloud(name, tensors, write_ascii=True),
    "pypcd4_binary": lambda name: points.save(name),
    "pypcd4_compressed": lambda name: points.save(name, encoding=Encoding.BINARY_COMPRESSED),
    "pypcd4_text": lambda name: points.save(name, encoding=Encoding.ASCII),
}


def by_pypcd4(name):
    found = PointCloud.from_path(name)
    return found.pc_data["x"], PointCloud.decode_rgb(found.pc_data["rgb"])


def by_pyntcloud(name):
    table = PyntCloud.from_file(name).points
    return table["x"], table[["red", "green", "blue"]].to_numpy()


def by_open3d(name):
    found = o3d.io.read_point_cloud(name)
    return np.asarray(found.points)[:, 0], np.rint(255 * np.asarray(found.colors))


def by_tensors(name):
    found = o3d.t.io.read_point_cloud(name)
    return found.point.positions.numpy()[:, 0], found.point.colors.numpy()


for written, write in WRITE.items():
    name = f"{written}.pcd"
    write(name)
    for read in (by_open3d, by_tensors, by_pypcd4, by_pyntcloud):
        try:
            across, found = read(name)
        except (ValueError, NotImplementedError) as error:
            print(f"{written} {read.__name__}: {type(error).__name__}")
            assert (written, read) == ("tensor_text", by_pypcd4) or read is by_pyntcloud
            assert written in ("tensor_text", "pypcd4_compressed")
            continue
        print(f"{written} {read.__name__}: {np.asarray(found).astype(int).tolist()}")
        assert np.allclose(across, places[:, 0])
        if written == "pypcd4_text":
            assert not np.asarray(found).any()
        elif read is by_pyntcloud and written != "pypcd4_binary":
            assert np.array_equal(found, OTHERS)
        else:
            assert np.array_equal(found, colours)
PYTHON
env/bin/python colours.py
cat > colours.mjs <<'NODE'
import assert from "node:assert";
import { readdirSync, readFileSync } from "node:fs";
import { Color } from "three";
import { PCDLoader } from "three/examples/jsm/loaders/PCDLoader.js";

for (const name of readdirSync(".").filter((entry) => entry.endsWith(".pcd")).sort()) {
  const { color } = new PCDLoader().parse(new Uint8Array(readFileSync(name)).buffer).geometry.attributes;
  const found = [0, 1, 2].map((row) => {
    const { r, g, b } = new Color(color.getX(row), color.getY(row), color.getZ(row)).convertLinearToSRGB();
    return [r, g, b].map((level) => Math.round(255 * level));
  });
  console.log(`${name} three: ${JSON.stringify(found)}`);
  const black = name === "pypcd4_text.pcd";
  const colours = [[255, 128, 0], [1, 2, 3], [200, 255, 254]];
  assert.deepStrictEqual(found, black ? [[0, 0, 0], [0, 0, 0], [0, 0, 0]] : colours);
}
NODE
node_modules/node/bin/node colours.mjs
echo "as described"
