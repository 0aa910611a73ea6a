"""COLMAP's models are read by the layout that COLMAP documents."""

import re
import struct

import numpy as np
import pytest

from anystyle.data.poses import read_poses, stored_cameras
from anystyle.io import colmap
from anystyle_captures.camera_files import colmap as colmap_files


def photograph(name):
    return colmap.PosedImage(name, 1, (1.0, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def model():
    cameras = {1: colmap.Camera("PINHOLE", (48, 64), (50.0, 51.0, 32.5, 23.5))}
    return colmap.Model(cameras, {3: photograph("a.png"), 7: photograph("b.png")})


def test_text_with_points_comments_and_blanks_in_names(tmp_path):
    (tmp_path / "cameras.txt").write_text("# cameras\n2 SIMPLE_RADIAL 640 480 500 320 240 0.01\n")
    (tmp_path / "images.txt").write_text(
        "# image by image\n1 1 0 0 0 0.5 0 0 2 my photo.jpg\n1.0 2.0 -1 3.0 4.0 5\n2 1 0 0 0 1 0 0 2 b.jpg\n\n"
    )
    found = colmap_files.read(tmp_path)
    assert [one.name for one in found.photographs.values()] == ["my photo.jpg", "b.jpg"]
    assert colmap_files.split(found.cameras[2])[1] == (0.01,)


@pytest.mark.parametrize("points", ["", "\n", "1 2 -1\n", "1 2 -1 3 4 5 5 6 -1 7 8 9\n"])
def test_images_of_one_line_or_two(tmp_path, points):
    (tmp_path / "cameras.txt").write_text("2 SIMPLE_RADIAL 640 480 500 320 240 0.01\n")
    names = ("0001.png", "2.png", "a b 3.png", "0004", "5")
    lines = (f"{index} 1 0 0 0 0.5 0 0 2 {name}\n{points}" for index, name in enumerate(names))
    (tmp_path / "images.txt").write_text("".join(lines))
    assert tuple(one.name for one in colmap_files.read(tmp_path).photographs.values()) == names


def test_damaged_files_are_refused(tmp_path):
    colmap.write(model(), tmp_path)
    whole = (tmp_path / "images.bin").read_bytes()
    for cut in (4, 30, len(whole) - 5):
        (tmp_path / "images.bin").write_bytes(whole[:cut])
        with pytest.raises(ValueError, match="is not a valid file of COLMAP's"):
            colmap_files.read(tmp_path)
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 3) + whole[8:] + whole[-len(whole[8:]) // 2 :])
    with pytest.raises(ValueError, match="two records have the same number"):
        colmap_files.read(tmp_path)
    (tmp_path / "images.bin").write_bytes(struct.pack("<Q", 2**60) + whole[8:])
    with pytest.raises(ValueError, match="more than the file holds"):
        colmap_files.read(tmp_path)
    (tmp_path / "images.bin").write_bytes(whole)
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QiiQQ4d", 1, 9, 1, 64, 48, 50.0, 51.0, 32.0, 24.0))
    with pytest.raises(ValueError, match="which is not there"):
        colmap_files.read(tmp_path)
    (tmp_path / "cameras.bin").write_bytes(b"\xff" * 64)
    with pytest.raises(ValueError, match="more than the file holds"):
        colmap_files.read(tmp_path)
    colmap.write(model(), tmp_path / "text", binary=False)
    (tmp_path / "text" / "images.txt").write_text("1 nan 0 0 0 0 0 0 1 a.png\n\n")
    with pytest.raises(ValueError, match=r"the pose of a\.png is not a rotation and translation"):
        colmap_files.read(tmp_path / "text")


@pytest.mark.parametrize("binary", [True, False])
def test_panoramas_and_unknown_models_are_refused_by_name(tmp_path, binary):
    lens = colmap.Camera("EQUIRECTANGULAR", (32, 64), (64.0, 32.0))
    colmap.write(colmap.Model({1: lens}, model().photographs), tmp_path / "sparse", binary=binary)
    with pytest.raises(ValueError, match="EQUIRECTANGULAR cameras, whose images are panoramas; poses=sfm cuts them"):
        read_poses(tmp_path, [tmp_path / "a.png"])
    file = tmp_path / "sparse" / ("cameras.bin" if binary else "cameras.txt")
    old, new = (struct.pack("<ii", 1, 17), struct.pack("<ii", 1, 18)) if binary else (b"EQUIRECTANGULAR", b"NEWEST")
    file.write_bytes(file.read_bytes().replace(old, new))
    with pytest.raises(ValueError, match=r"(number 18|NEWEST), which is not known; .*colmap image_undistorter"):
        read_poses(tmp_path, [tmp_path / "a.png"])


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize(("name", "encoding"), [("照片1.png", "gbk"), ("été.png", "latin-1")])
def test_names_in_other_encodings_are_those_of_the_files(tmp_path, caplog, name, encoding, binary):
    colmap.write(colmap.Model(model().cameras, {1: photograph("N")}), tmp_path, binary=binary)
    file = tmp_path / ("images.bin" if binary else "images.txt")
    old, new = (b"N\0", name.encode(encoding) + b"\0") if binary else (b" N\n", b" " + name.encode(encoding) + b"\n")
    file.write_bytes(file.read_bytes().replace(old, new))
    assert list(read_poses(tmp_path, [tmp_path / name])) == [tmp_path / name]
    assert "differ in their encoding" in caplog.text


def test_of_several_models_the_one_of_most_photographs_is_read(tmp_path, caplog):
    whole, images = model(), [tmp_path / "a.png", tmp_path / "b.png"]
    part = colmap.Model(whole.cameras, {3: whole.photographs[3]})
    other = colmap.Model(whole.cameras, {number: photograph(f"{number}.png") for number in range(9)})
    for number, each in enumerate((part, whole, other)):
        colmap.write(each, tmp_path / "sparse" / str(number))
    assert list(read_poses(tmp_path, images)) == images
    assert re.search(r"sparse/1 is read, with 2 of 2 .*left out: .*sparse/0 with 1, .*sparse/2 with 0", caplog.text)
    assert list(read_poses(tmp_path, images[:1], "sparse/0")) == images[:1]
    assert len(stored_cameras(tmp_path)) == 9  # without photographs, the largest


def test_models_of_rigs_are_read(tmp_path):
    """As the installed version writes them, with rigs and frames beside."""
    pycolmap = pytest.importorskip("pycolmap")
    options = pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=3, num_points3D=9)
    whole = pycolmap.synthesize_dataset(options)
    for suffix, write in (("bin", whole.write_binary), ("txt", whole.write_text)):
        (tmp_path / suffix).mkdir()
        write(tmp_path / suffix)
        assert (tmp_path / suffix / f"rigs.{suffix}").is_file()
        cameras = stored_cameras(tmp_path / suffix)
        for image in whole.images.values():
            pose = cameras[image.name].world_from_camera
            np.testing.assert_allclose(pose[:3], image.cam_from_world().inverse().matrix(), atol=1e-9)


def test_other_peoples_poses_are_refused(tmp_path):
    colmap.write(model(), tmp_path / "sparse")
    with pytest.raises(ValueError, match="names none of the photographs"):
        read_poses(tmp_path, [tmp_path / "elsewhere.png"])
