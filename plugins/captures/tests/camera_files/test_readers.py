"""What programs export is read as it was meant: published conventions, other readers, and back from what is written."""

import json

import numpy as np
import pytest
from PIL import Image

from anystyle.data.folder import read_views
from anystyle.data.poses import read_poses, stored_cameras
from anystyle.pipeline.cameras import from_files
from anystyle_captures.camera_files import samples
from anystyle_captures.camera_files.conversion import OPENCV_FROM_OPENGL
from anystyle_captures.camera_files.lens import Lens
from tests.support.pictures import save
from tests.support.refusals import raises_line

SIZE = (48, 64)
LENS = Lens(SIZE, (50.0, 50.0), (33.0, 23.5), (-0.1, 0.02, -0.003, 0.001), (0.004, -0.002))
WIDE = Lens(SIZE, (30.0, 30.0), (32.0, 24.0), (0.02, -0.01, 0.0, 0.0), fisheye=True)


def transforms(folder, images, lens):
    samples.write_transforms(folder / "transforms.json", images, samples.poses(), lens)


def model(folder, images, lens):
    samples.write_colmap(folder / "sparse", images, samples.poses(), lens)


def known(folder):
    """Views, sources and cameras of a folder, at the photographs' own size."""
    return from_files(*read_views([folder], short_side=48, multiple=16, max_views=8))


BY_ALL = Lens(SIZE, (50.0, 50.0), (33.0, 23.5), (-0.1, 0.02, 0.0, 0.0), (0.004, -0.002))


@pytest.mark.parametrize(("write", "lens"), [(transforms, LENS), (transforms, WIDE), (model, BY_ALL)])
def test_what_is_written_is_read(tmp_path, write, lens):
    images = samples.write_photographs(tmp_path / "images", SIZE)
    write(tmp_path, images, lens)
    cameras = read_poses(tmp_path, images)
    for image, pose in zip(images, samples.poses(), strict=True):
        np.testing.assert_allclose(cameras[image].world_from_camera, pose, atol=1e-6)
        np.testing.assert_allclose(cameras[image].intrinsics, lens.matrix(), atol=1e-6)
        assert cameras[image].undistortion.apply.args[0].radial == pytest.approx(lens.radial, abs=1e-9)
        assert cameras[image].undistortion.apply.args[0].tangential == pytest.approx(lens.tangential, abs=1e-9)
    views, sources, found = known(tmp_path)
    np.testing.assert_allclose(found.views.intrinsics[0, 0], lens.undistortion().intrinsics, atol=1e-4)
    # What is drawn on a photograph, such as a mask, is undistorted as the view was.
    drawn = np.asarray(sources[0].of_view(Image.open(images[0])))
    assert np.abs(drawn / 255 - views.images[0, 0].permute(1, 2, 0).numpy()).max() < 0.02


@pytest.mark.parametrize("suffix", ["png", "tif"])
@pytest.mark.parametrize("orientation", [6, 8])
def test_photographs_that_lie_on_a_side_get_upright_cameras(tmp_path, orientation, suffix):
    """A point is seen at the same place of the picture, whichever way it is held."""
    exif = Image.Exif()
    exif[0x0112] = orientation
    pixels = np.random.default_rng(0).integers(0, 255, (*SIZE, 3), dtype=np.uint8)
    images = [save(tmp_path / "images" / f"{number}.{suffix}", pixels, exif=exif) for number in range(3)]
    model(tmp_path, images, LENS)
    camera = read_poses(tmp_path, images)[images[1]]
    point = samples.poses()[1] @ [0.2, -0.1, 1.0, 1.0]
    column, row = (LENS.matrix() @ [0.2, -0.1, 1.0])[:2]
    wanted = (SIZE[0] - row, column) if orientation == 6 else (row, SIZE[1] - column)
    x, y, z, _ = np.linalg.inv(camera.world_from_camera) @ point
    np.testing.assert_allclose((camera.intrinsics @ [x / z, y / z, 1])[:2], wanted, atol=1e-9)
    assert camera.size == (64, 48)
    views, _, _ = known(tmp_path)
    lying = np.asarray(LENS.undistortion().apply(Image.fromarray(pixels)))
    seen = (views.images[0, 0].permute(1, 2, 0).numpy() * 255).round()
    assert np.abs(seen - np.rot90(lying, -1 if orientation == 6 else 1)).mean() < 3


def rig(folder):
    """Two folders with a photograph of the same name each, and one more."""
    images = samples.write_photographs(folder / "images", SIZE)
    places = [folder / "images" / name for name in ("cam0/0001.png", "cam1/0001.png", "cam1/0002.png")]
    for image, place in zip(images, places, strict=True):
        place.parent.mkdir(exist_ok=True)
        image.rename(place)
    return places


@pytest.mark.parametrize("write", [model, transforms])
def test_photographs_of_equal_names_get_their_own_poses(tmp_path, write, monkeypatch):
    images = rig(tmp_path)
    write(tmp_path, images, LENS)
    _, sources, found = known(tmp_path)
    assert [source.path for source in sources] == images
    assert [source.name for source in sources] == ["cam0_0001", "cam1_0001", "cam1_0002"] == list(found.names)
    np.testing.assert_allclose(found.views.world_from_camera[0], samples.poses(), atol=1e-5)
    _, _, found = known(tmp_path / "images" / "cam1")  # and one folder of them
    np.testing.assert_allclose(found.views.world_from_camera[0], samples.poses()[1:], atol=1e-5)


def test_llffs_poses_are_in_alphabetical_order(tmp_path):
    images = samples.write_photographs(tmp_path / "images", SIZE)
    for image, name in zip(images, ("10.png", "9.png", "100.png"), strict=True):
        image.rename(image.with_name(name))
    samples.write_llff(tmp_path / "poses_bounds.npy", samples.poses(), samples.pinhole())
    cameras = read_poses(tmp_path, [tmp_path / "images" / name for name in ("9.png", "10.png", "100.png")])
    for name, pose in zip(("10.png", "100.png", "9.png"), samples.poses(), strict=True):
        np.testing.assert_allclose(cameras[tmp_path / "images" / name].world_from_camera, pose, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"OPENCV"', '"EQUIRECTANGULAR"', "panoramas .* poses=sfm cuts them"),
        ('"OPENCV"', '"FOV"', "camera_model FOV is not one of"),
        ("[[0.9999999999999999,", "[[-0.9999999999999999,", "a pose mirrors: its axes are left-handed"),
        ("images/view_1.png", "images/view_0.png", "has two cameras of the name images/view_0.png"),
    ],
)
def test_what_cannot_be_read_ends_in_one_line(tmp_path, old, new, words):
    images = samples.write_photographs(tmp_path, SIZE)
    transforms(tmp_path, images, LENS)
    text = (tmp_path / "transforms.json").read_text()
    assert old in text
    (tmp_path / "transforms.json").write_text(text.replace(old, new))
    with raises_line(ValueError, match=words):
        read_poses(tmp_path, images)


def test_other_files_beside_photographs_are_left_alone(tmp_path):
    images = samples.write_photographs(tmp_path, SIZE)
    (tmp_path / "notes.csv").write_text("name,price\nview_0.png,3\n")
    (tmp_path / "view_0.xmp").write_text('<x:xmpmeta xmlns:x="adobe:ns:meta/"/>')
    (tmp_path / "a.xml").write_text("<document><page/></document>")
    (tmp_path / "cameras").mkdir()
    assert read_poses(tmp_path, images) == {}


@pytest.mark.parametrize("place", ["colmap", "colmap_text", "colmap/sparse/0", "distorted/sparse/0"])
def test_models_are_found_where_programs_put_them(tmp_path, place):
    images = samples.write_photographs(tmp_path / "input", SIZE)
    samples.write_colmap(tmp_path / place, images, samples.poses(), LENS)
    assert len(read_poses(tmp_path, images)) == len(images)


@pytest.mark.parametrize(
    ("shared", "own", "height", "angle"),
    [
        ({"camera_angle_x": 1.0, "camera_angle_y": 0.7}, {}, 24, (1.0, 0.7)),
        ({"camera_angle_y": 0.7}, {"fl_x": 32.0}, 24, (np.pi / 2, 0.7)),
        ({"fl_x": 50.0, "fl_y": 40.0}, {"camera_angle_x": 1.2, "camera_angle_y": 0.9}, 24, (1.2, 0.9)),
        ({"fl_x": 50.0, "is_fisheye": False}, {"camera_angle_x": 1.2, "k1": 0.1, "is_fisheye": True}, 32, (1.2, 1.2)),
    ],
)
def test_a_frames_own_lens_counts_before_the_shared_one(tmp_path, shared, own, height, angle):
    frames = [{"file_path": "a.png", "transform_matrix": np.eye(4).tolist(), **own}]
    # A byte order mark is no damage.
    (tmp_path / "transforms.json").write_text(json.dumps({"w": 64, "h": 48, **shared, "frames": frames}), "utf-8-sig")
    (camera,) = stored_cameras(tmp_path).values()
    np.testing.assert_allclose(np.diag(camera.intrinsics)[:2], [32, height] / np.tan(np.divide(angle, 2)))
    assert ("k1" in own) == (camera.undistortion is not None and camera.undistortion.apply.args[0].fisheye)


def test_blenders_splits_are_one_capture_of_the_size_of_its_images(tmp_path):
    matrices, angle = samples.poses(), 0.7
    for split, count in (("train", 2), ("test", 1)):
        images = samples.write_photographs(tmp_path / split, SIZE, count)
        poses = [matrices.pop(0) @ OPENCV_FROM_OPENGL for _ in images]
        frames = [
            {"file_path": f"./{split}/{image.stem}", "rotation": 0.01, "transform_matrix": pose.tolist()}
            for image, pose in zip(images, poses, strict=True)
        ]
        (tmp_path / f"transforms_{split}.json").write_text(json.dumps({"camera_angle_x": angle, "frames": frames}))
    images = [tmp_path / "train/view_0.png", tmp_path / "train/view_1.png", tmp_path / "test/view_0.png"]
    for cameras in (read_poses(tmp_path, images), stored_cameras(tmp_path)):
        for camera, pose in zip(cameras.values(), samples.poses(), strict=True):
            np.testing.assert_allclose(camera.world_from_camera, pose, atol=1e-12)
            focal = SIZE[1] / 2 / np.tan(angle / 2)
            expected = [[focal, 0, SIZE[1] / 2], [0, focal, SIZE[0] / 2], [0, 0, 1]]
            np.testing.assert_allclose(camera.intrinsics, expected)
            assert camera.size == SIZE


def test_cameras_whose_axes_are_scaled_are_as_if_they_were_not(tmp_path, caplog):
    images = samples.write_photographs(tmp_path / "images", SIZE)
    write, file = samples.write_transforms, tmp_path / "transforms.json"
    write(file, images, [pose @ np.diag([0.3, 0.3, 0.3, 1.0]) for pose in samples.poses()], samples.pinhole(SIZE))
    for camera, pose in zip(read_poses(tmp_path, images).values(), samples.poses(), strict=True):
        np.testing.assert_allclose(camera.world_from_camera, pose, atol=1e-12)
    assert f"{file}: the axes of cameras are up to 0.3 long" in caplog.text
    write(file, images, [pose @ np.diag([0.3, 0.3, 1.0, 1.0]) for pose in samples.poses()], samples.pinhole(SIZE))
    with pytest.raises(ValueError, match="a pose has no rotation in it"):
        read_poses(tmp_path, images)
