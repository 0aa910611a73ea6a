"""Scenes and styles from folders in the layouts of the field."""

import json
from functools import partial

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.data.poses import read_poses
from anystyle.data.scene_folder import FolderScenes
from anystyle.data.style_folder import FolderStyles
from tests.support.pictures import picture
from tests.support.real_data import real
from tests.support.refusals import raises_line

save = partial(picture, value=100, size=(60, 40))


def rotation(angle):
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]])


@pytest.fixture
def capture(tmp_path):
    """Two scenes; the first with cameras for 120 x 80 pixels, stored at half of that, and one image too many."""
    frames = []
    for number in (1, 2, 10):
        save(tmp_path / "b10" / "images" / f"f_{number}.png", value=20 * number)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = rotation(0.1 * number), [number, 2, 3]
        frames.append({"file_path": f"images/f_{number}.png", "transform_matrix": pose.tolist()})
    save(tmp_path / "b10" / "images" / "f_3.png")
    content = {"w": 120, "h": 80, "fl_x": 100, "fl_y": 90, "cx": 61, "cy": 39, "frames": frames}
    (tmp_path / "b10" / "transforms.json").write_text(json.dumps(content))
    for number in range(4):
        save(tmp_path / "b9" / f"{number}.jpg", size=(50, 80))
    (tmp_path / "empty").mkdir()
    return tmp_path


def source(root, **options):
    return FolderScenes(root=str(root), **{"short_side": 16, "multiple": 8, **options})


def test_scenes_are_folders_in_natural_order_each_with_its_aspect(capture):
    scenes = source(capture)
    assert [scenes.name(scene) for scene in range(len(scenes))] == ["b9", "b10"]
    assert [scenes.num_views(scene) for scene in range(2)] == [4, 3]
    upright = scenes.read(0, [2, 0])
    assert upright.images.shape == (1, 2, 3, 24, 16) and upright.names == ("2", "0") and upright.cameras is None
    assert source(capture / "b9").name(0) == "b9"


def test_a_rigs_photographs_of_one_name_are_told_apart(capture):
    frames = json.loads((capture / "b10" / "transforms.json").read_text())["frames"]
    for number, name in enumerate(("cam0/f.png", "cam1/f.png")):
        save(capture / "rig" / "images" / name)
        frames[number]["file_path"] = f"images/{name}"
    content = {"w": 120, "h": 80, "fl_x": 100, "frames": frames[:2][::-1]}
    (capture / "rig" / "transforms.json").write_text(json.dumps(content))
    views = source(capture).read(2, [0, 1])
    assert views.names == ("cam0_f", "cam1_f")
    torch.testing.assert_close(views.cameras.world_from_camera[0, :, 0, 3], torch.tensor([1.0, 2.0]))


def test_opengl_cameras_become_opencv_cameras_of_the_view(capture):
    views = source(capture).read(1, [0, 2])
    assert views.names == ("f_1", "f_10") and views.size == (16, 24)
    pose = views.cameras.world_from_camera[0, 1].numpy()
    np.testing.assert_allclose(pose[:3, :3], rotation(1.0) @ np.diag([1, -1, -1]), atol=1e-6)
    np.testing.assert_allclose(pose[:3, 3], [10, 2, 3])
    # From 120 x 80 to 24 x 16: a fifth.
    expected = torch.tensor([[20.0, 0, 12.2], [0, 18, 7.8], [0, 0, 1]])
    torch.testing.assert_close(views.cameras.intrinsics[0, 0], expected)
    torch.testing.assert_close(views.images.mean((0, 2, 3, 4)) * 255, torch.tensor([20.0, 200]))


def test_an_index_names_scenes_and_may_not_leave_the_root(capture, caplog):
    (capture / "train_index.json").write_text(json.dumps(["b10", "gone"]))
    scenes = source(capture, index="train_index.json")
    assert [scenes.name(scene) for scene in range(len(scenes))] == ["b10"] and "1 of 2 scenes" in caplog.text
    (capture / "bad.json").write_text(json.dumps(["../../etc"]))
    with pytest.raises(ValueError, match="outside"):
        source(capture, index="bad.json")
    (capture / "bad.json").write_text("{}")
    with pytest.raises(ValueError, match="list of folder names"):
        source(capture, index="bad.json")


def test_llff_axes_are_down_right_back(tmp_path):
    rows = np.zeros((3, 17))
    for number, row in enumerate(rows):
        save(tmp_path / f"{number}.png")
        opencv = rotation(0.2 * number)
        matrix = np.stack([opencv[:, 1], opencv[:, 0], -opencv[:, 2], [number, 0, 0], [80, 120, 100]], axis=1)
        row[:15] = matrix.ravel()
    np.save(tmp_path / "poses_bounds.npy", rows)
    cameras = source(tmp_path).read(0, [2]).cameras
    np.testing.assert_allclose(cameras.world_from_camera[0, 0, :3, :3], rotation(0.4), atol=1e-6)
    torch.testing.assert_close(cameras.intrinsics[0, 0], torch.tensor([[20.0, 0, 12], [0, 20, 8], [0, 0, 1]]))
    save(tmp_path / "9.png")
    with pytest.raises(ValueError, match="3 poses for 4 images"):
        source(tmp_path).read(0, [0])


def test_cameras_of_a_real_capture_see_the_same_points():
    """The epipolar geometry of the stored poses fits matches between real photographs."""
    cv2 = pytest.importorskip("cv2")
    views = FolderScenes(root=str(real("scenes/train")), short_side=252).read(0, [0, 3])
    gray = [(image.mean(0) * 255).byte().numpy() for image in views.images[0]]
    sift = cv2.SIFT_create(800)
    (ka, da), (kb, db) = (sift.detectAndCompute(image, None) for image in gray)
    pairs = [a for a, b in cv2.BFMatcher().knnMatch(da, db, k=2) if a.distance < 0.7 * b.distance]
    assert len(pairs) > 60
    half = np.array([0.5, 0.5, 0])
    pa = np.array([[*ka[m.queryIdx].pt, 1] for m in pairs]) + half
    pb = np.array([[*kb[m.trainIdx].pt, 1] for m in pairs]) + half
    k = views.cameras.intrinsics[0].double().numpy()
    relative = (views.cameras.camera_from_world[0, 1] @ views.cameras.world_from_camera[0, 0]).double().numpy()
    tx, ty, tz = relative[:3, 3]
    cross = np.array([[0, -tz, ty], [tz, 0, -tx], [-ty, tx, 0]])
    fundamental = np.linalg.inv(k[1]).T @ cross @ relative[:3, :3] @ np.linalg.inv(k[0])
    lines = pa @ fundamental.T
    assert np.median(np.abs((pb * lines).sum(1)) / np.hypot(lines[:, 0], lines[:, 1])) < 1.5


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("nonsense", "not a valid transforms.json"),
        ("[]", "not a valid transforms.json"),
        ('{"frames": [{"file_path": "a.png"}]}', "no w and h"),
        ('{"w": 9, "h": 9, "fl_x": 9, "frames": [{"file_path": "a.png", "transform_matrix": [[1]]}]}', "not a 4x4"),
        ('{"w": 9, "h": 9, "fl_x": 9, "frames": [{"file_path": "a.png", "transform_matrix": '
         "[[9,0,0,0],[0,1,0,0],[0,0,1,0]]}]}", "no rotation"),
        ('{"w": 9, "h": 9, "fl_x": 9, "frames": []}', "none of the photographs"),
    ],
)  # fmt: skip
def test_damaged_transforms_are_refused_in_one_line(tmp_path, content, words):
    (tmp_path / "transforms.json").write_text(content)
    with raises_line(ValueError, match=words):
        read_poses(tmp_path, [tmp_path / "a.png"])


def test_damaged_poses_bounds_are_refused(tmp_path):
    path, pickled = tmp_path / "poses_bounds.npy", np.array([{"a": 1}], dtype=object)
    for value, words in ((np.zeros((1, 5)), "N x 17"), (np.zeros((1, 17)), "focal length 0"), (pickled, "valid array")):
        np.save(path, value, allow_pickle=True)
        with pytest.raises(ValueError, match=words):
            read_poses(tmp_path, [tmp_path / "a.png"])
    path.write_bytes(b"nonsense")
    with pytest.raises(ValueError, match="not a valid array of poses"):
        read_poses(tmp_path, [tmp_path / "a.png"])


def test_bad_scene_folders(tmp_path, capture):
    with pytest.raises(ValueError, match="no such folder"):
        source(tmp_path / "absent")
    with pytest.raises(ValueError, match="no scene lies there"):
        source(tmp_path / "empty")
    scenes = source(capture)
    for views in ([], [4], [-1]):
        with pytest.raises(ValueError, match="0 to 3"):
            scenes.read(0, views)
    with pytest.raises(ValueError, match="there are 2"):
        scenes.num_views(2)


def test_a_folder_of_styles_with_captions(tmp_path):
    left = np.zeros((40, 80, 3), np.uint8)
    left[:, 20:60] = 200
    Image.fromarray(left).save(tmp_path / "s10.png")
    save(tmp_path / "s9.jpg")
    (tmp_path / "captions.jsonl").write_text('{"image": "s10.png", "text": "grey; \\"quoted\\""}\n\n')
    styles = FolderStyles(root=str(tmp_path), size=16)
    assert len(styles) == 2
    first, second = styles.read(0), styles.read(1)
    assert (first.names, first.text) == (("s9",), ("",)) and second.text == ('grey; "quoted"',)
    # The middle square is all that is seen.
    assert second.image.min().item() * 255 > 180
    (tmp_path / "captions.jsonl").write_text('{"image": "s10.png"}\n')
    (tmp_path / "other.txt").write_text("s9.jpg;some words\nno separator\n")
    for file, words in ((None, "line 1 of"), ("other.txt", "line 2 of"), ("absent.txt", "no file of captions")):
        with pytest.raises(ValueError, match=words):
            FolderStyles(root=str(tmp_path), captions=file)
    (tmp_path / "sub").mkdir()
    with pytest.raises(ValueError, match="no images"):
        FolderStyles(root=str(tmp_path / "sub"))
