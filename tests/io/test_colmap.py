"""COLMAP's models: what is written is read, by the layout that COLMAP documents."""

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from anystyle.io import colmap


def model():
    x, y, z, w = (float(value) for value in Rotation.from_euler("xyz", [0.2, -0.4, 0.7]).as_quat())
    return colmap.Model(
        cameras={1: colmap.Camera("PINHOLE", (48, 64), (50.0, 51.0, 32.5, 23.5))},
        photographs={
            3: colmap.PosedImage("a.png", 1, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            7: colmap.PosedImage("b.png", 1, (w, x, y, z), (0.1, -0.2, 3.0)),
        },
        points=np.array([[0.5, 1.5, 2.5], [3.0, -1.0, 0.25]]),
        colors=np.array([[1, 2, 3], [250, 128, 0]], np.uint8),
    )


def test_binary_points_have_the_documented_layout(tmp_path):
    colmap.write(model(), tmp_path)
    data = (tmp_path / "points3D.bin").read_bytes()
    assert struct.unpack_from("<Q", data) == (2,)
    number, x, y, z, r, g, b, error, track = struct.unpack_from("<Q3d3BdQ", data, 8 + 51)
    assert (number, x, y, z, r, g, b, error, track) == (2, 3.0, -1.0, 0.25, 250, 128, 0, 0.0, 0)
    assert len(data) == 8 + 2 * 51


def test_another_reader_agrees(tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    for binary in (True, False):
        folder = tmp_path / str(binary)
        colmap.write(model(), folder, binary=binary)
        scene = pycolmap.Reconstruction(str(folder))
        assert (scene.num_images(), scene.num_points3D()) == (2, 2)
        centre = scene.image(7).projection_center()
        stored = model().photographs[7]
        w, x, y, z = stored.rotation
        expected = -Rotation.from_quat([x, y, z, w]).as_matrix().T @ np.array(stored.translation)
        np.testing.assert_allclose(centre, expected, atol=1e-9)
