"""COLMAP's models are read by the layout that COLMAP documents."""

import struct

import numpy as np
import pytest
from PIL import Image
from scipy.spatial.transform import Rotation

from anystyle.data.poses import read_poses
from anystyle.io import colmap
from anystyle_captures.camera_files import colmap_files


def model():
    turn = Rotation.from_euler("xyz", [0.2, -0.4, 0.7]).as_quat()
    x, y, z, w = (float(value) for value in turn)
    return colmap.Model(
        cameras={1: colmap.Camera("PINHOLE", (48, 64), (50.0, 51.0, 32.5, 23.5))},
        photographs={
            3: colmap.Photograph("a.png", 1, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0)),
            7: colmap.Photograph("b.png", 1, (w, x, y, z), (0.1, -0.2, 3.0)),
        },
        points=np.array([[0.5, 1.5, 2.5], [3.0, -1.0, 0.25]]),
        colors=np.array([[1, 2, 3], [250, 128, 0]], np.uint8),
    )


@pytest.mark.parametrize("binary", [True, False])
def test_cameras_beside_photographs(tmp_path, binary):
    (tmp_path / "images").mkdir()
    for name in ("a.png", "b.png", "c.png"):
        Image.new("RGB", (64, 48)).save(tmp_path / "images" / name)
    colmap.write(model(), tmp_path / "sparse" / "0", binary=binary)
    known = read_poses(tmp_path, [tmp_path / "images" / name for name in ("a.png", "b.png", "c.png")])
    assert sorted(known) == ["a.png", "b.png"]
    camera, stored = known["b.png"], model().photographs[7]
    w, x, y, z = stored.rotation
    motion = np.linalg.inv(camera.world_from_camera)
    np.testing.assert_allclose(motion[:3, :3], Rotation.from_quat([x, y, z, w]).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(motion[:3, 3], stored.translation, atol=1e-12)
    np.testing.assert_allclose(camera.intrinsics, [[50, 0, 32.5], [0, 51, 23.5], [0, 0, 1]])


def test_text_with_points_comments_and_blanks_in_names(tmp_path):
    (tmp_path / "cameras.txt").write_text("# cameras\n2 SIMPLE_RADIAL 640 480 500 320 240 0.01\n")
    (tmp_path / "images.txt").write_text(
        "# two lines an image\n1 1 0 0 0 0.5 0 0 2 my photo.jpg\n1.0 2.0 -1 3.0 4.0 5\n2 1 0 0 0 1 0 0 2 b.jpg\n\n"
    )
    found = colmap_files.read(tmp_path)
    assert [one.name for one in found.photographs.values()] == ["my photo.jpg", "b.jpg"]
    assert colmap_files.split(found.cameras[2])[1] == (0.01,)


def test_damaged_files_are_refused(tmp_path):
    colmap.write(model(), tmp_path)
    whole = (tmp_path / "images.bin").read_bytes()
    for cut in (4, 30, len(whole) - 5):
        (tmp_path / "images.bin").write_bytes(whole[:cut])
        with pytest.raises(ValueError, match="is damaged or no file of COLMAP's"):
            colmap_files.read(tmp_path)
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    with pytest.raises(ValueError, match="more than the file holds"):
        colmap_files.read(tmp_path)
    (tmp_path / "images.bin").write_bytes(whole)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 9, 1, 64, 48, 50.0, 51.0, 32.0, 24.0))
    with pytest.raises(ValueError, match="which is not there"):
        colmap_files.read(tmp_path)


def test_lenses_without_an_undistortion_and_other_peoples_poses_are_refused(tmp_path):
    lens = colmap.Camera("FOV", (48, 64), (50.0, 51.0, 32.0, 24.0, 0.9))
    colmap.write(colmap.Model({1: lens}, model().photographs), tmp_path / "sparse")
    with pytest.raises(ValueError, match="undistort"):
        read_poses(tmp_path, [tmp_path / "a.png"])
    colmap.write(model(), tmp_path / "sparse")
    with pytest.raises(ValueError, match="names none of the photographs"):
        read_poses(tmp_path, [tmp_path / "elsewhere.png"])
