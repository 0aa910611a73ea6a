"""Which photograph and style an image belongs to, and what is said where there is none."""

import unicodedata
from itertools import product

import numpy as np
import pytest
import torch

from anystyle.errors import UserError
from anystyle.evaluation.comparisons import Reader, write_cameras
from anystyle.evaluation.pairing import pair
from anystyle.testing.inputs import cameras
from tests.support.evaluation_cases import folders, picture


def test_scenes_styles_and_frames(tmp_path):
    pairing = pair(*folders(tmp_path, frames=11))
    assert [(cell.scene, cell.style) for cell in pairing.cells] == [
        ("one", "a"), ("one", "b"), ("two", "a"), ("two", "b")
    ]  # fmt: skip
    cell = pairing.cells[2]
    assert cell.frames == tuple(str(frame) for frame in range(11))
    assert [path.name for path in cell.content] == [f"{frame:03d}.png" for frame in range(11)]
    assert cell.reference.name == "a.png"
    assert pairing.lacking() == ""
    read = Reader()(cell)
    assert read.content.shape == read.stylized.shape == (1, 11, 3, 8, 12)
    torch.testing.assert_close(read.stylized[0, :, 0, 0, 0] * 255, 60.0 + torch.arange(11.0))
    torch.testing.assert_close(read.content[0, :, 0, 0, 0] * 255, 100.0 + torch.arange(11.0))
    assert read.style.image.shape == (1, 3, 6, 6)
    assert (read.scenes, read.styles) == (("two",), ("a",))


def test_triples_of_equal_names(tmp_path):
    for kind in ("content", "style", "generated"):
        for name in ("00_0", "00_1", "01_0", "01_1"):
            picture(tmp_path / kind / "Train" / f"{name}.jpg", 9)
    cells = pair(tmp_path / "content", tmp_path / "style", tmp_path / "generated").cells
    assert [(cell.style, len(cell.frames)) for cell in cells] == [("00", 2), ("01", 2)]
    assert cells[1].reference.name == "01_0.jpg" and cells[1].content[1].name == "01_1.jpg"


def test_what_has_no_partner_is_listed(tmp_path):
    content, style, stylized = folders(tmp_path)
    picture(stylized / "one" / "a_7.png", 0)
    picture(stylized / "one" / "c_0.png", 0)
    picture(stylized / "three" / "d_9.png", 0)
    with pytest.raises(ValueError) as caught:
        pair(content, style, stylized)
    assert str(caught.value).startswith(
        "3 of 15 stylized images have no partner: one/a_7 (no content 7), one/c_0 (no style c), "
        "three/d_9 (no content 9, no style d)"
    )


def test_what_is_missing_is_refused_by_name_or_left_out_by_number(tmp_path):
    content, style, stylized = folders(tmp_path, scenes=("one", "two", "three"), styles=("a", "b", "c"), frames=11)
    for name in ("one/a_3", "one/a_5", "one/a_7", "one/c_0"):
        (stylized / f"{name}.png").unlink()
    for path in {*(stylized / "two").iterdir(), *stylized.glob("*/b_*")}:
        path.unlink()
    with pytest.raises(UserError) as caught:
        pair(content, style, stylized)
    assert str(caught.value) == (
        "59 of 99 stylized images are missing: scene two (all 33), style b (all 22), one/a (3 of 11: 003, 005, 007), "
        "one/c (1 of 11: 000); add them, or missing=allow to judge what is there"
    )
    pairing = pair(content, style, stylized, missing="allow")
    assert [(cell.scene, cell.style, len(cell.frames)) for cell in pairing.cells] == [
        ("one", "a", 8), ("one", "c", 10), ("three", "a", 11), ("three", "c", 11)
    ]  # fmt: skip
    assert pairing.cells[0].numbers == (0, 1, 2, 4, 6, 8, 9, 10)
    # Frame 1 and frame 2 follow each other, 2 and 4 do not.
    assert Reader()(pairing.cells[0]).neighbours() == [(0, 1), (1, 2), (5, 6), (6, 7)]


@pytest.mark.parametrize("layout", ["{scene}/{style}/{frame}", "{scene}/{style}_{frame}"])
@pytest.mark.parametrize(
    ("scene", "style", "frame"),
    [
        ("wave", "van_gogh", "frame_{:05d}"),
        ("my scene.v2", "a.b", "IMG_{:04d}"),
        ("scène", "日本_画", "v1.5_{:d}"),
        ("a_b", "a", "b_{:d}"),
        ("00", "00", "{:03d}"),
    ],
)
def test_names_are_found_whole(tmp_path, layout, scene, style, frame):
    for number in (2, 10, 1):
        content = picture(tmp_path / "content" / unicodedata.normalize("NFC", scene) / f"{frame.format(number)}.png", 1)
        name = layout.format(scene=unicodedata.normalize("NFD", scene), style=style, frame=frame.format(number))
        picture(tmp_path / "stylized" / f"{name}.png", 2)
    for name in (style, f"{style}_2", "other"):
        picture(tmp_path / "style" / f"{name}.png", 3)
    (cell,) = pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized", missing="allow").cells
    assert (cell.scene, cell.style) == (content.parent.name, style)
    assert [path.stem for path in cell.content] == [frame.format(number) for number in (1, 2, 10)]


@pytest.mark.parametrize("name", ["wave/frame_00001", "wave_frame_00001", "Wave/frame_1"])
@pytest.mark.parametrize("scene", ["", "one/"])
def test_one_scene_needs_no_folder(tmp_path, name, scene):
    picture(tmp_path / "content" / scene / "frame_00001.png", 1)
    picture(tmp_path / "stylized" / f"{name}.png", 2)
    picture(tmp_path / "style" / "wave.jpg", 3)
    (cell,) = pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized").cells
    assert (cell.scene, cell.style, cell.content[0].stem) == (scene.rstrip("/"), "wave", "frame_00001")


def test_two_readings_are_told_with_what_to_type(tmp_path):
    for name in ("content/one/1", "content/one/b_1", "style/a", "style/a_b", "stylized/one/a_b_1"):
        picture(tmp_path / f"{name}.png", 0)
    with pytest.raises(UserError) as caught:
        pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized", missing="allow")
    assert str(caught.value) == (
        "one/a_b_1 may be b_1.png in style a.png or 1.png in style a_b.png; name it one/a/b_1 or one/a_b/1"
    )


@pytest.mark.parametrize(
    ("layout", "told"),
    [
        *((layout, f"look like {layout.format(scene='SCENE', style='STYLE', frame='FRAME')}.png: arrange them as ")
          for layout in ("{style}/{scene}/{frame}", "{style}/{scene}_{frame}", "{scene}_{style}/{frame}",
                         "{scene}/{frame}/{style}", "{scene}/{frame}_{style}", "{scene}/{style}-{frame}",
                         "{scene}_{style}_{frame}")),
        ("{scene}/{style}/rgb/{frame}", "these look like SCENE/STYLE/FOLDER/FRAME.png: arrange"),
        ("nnfm/{scene}/{style}/{frame}", "look like FOLDER/SCENE/STYLE/FRAME.png: give --stylized one folder, such"),
        ("{style}/{frame}", "these look like STYLE/FRAME.png of one scene, and --content holds several (one, two)"),
        ("{scene}/x{style}/{frame}", "expected SCENE/STYLE/FRAME.png, with frames named like 'f_0' and styles like"),
    ],
)  # fmt: skip
def test_the_layout_that_was_found_is_told(tmp_path, layout, told):
    for scene, style, frame in product(("one", "two"), ("a_b", "c"), ("f_0", "f_1")):
        picture(tmp_path / "content" / scene / f"{frame}.png", 0)
        picture(tmp_path / "style" / f"{style}.png", 0)
        picture(tmp_path / "stylized" / f"{layout.format(scene=scene, style=style, frame=frame)}.png", 0)
    with pytest.raises(UserError) as caught:
        pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized")
    assert told in str(caught.value) and "\n" not in str(caught.value)


def test_photographs_of_one_scene_are_not_those_of_two(tmp_path):
    content, style, stylized = folders(tmp_path)
    with pytest.raises(UserError, match=r"of one scene, and the stylized images of 2 \(one, two\); give --content"):
        pair(content / "one", style, stylized)


def test_folders_that_cannot_be_judged(tmp_path):
    content, style, stylized = folders(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "words").mkdir()
    (tmp_path / "words" / "a.txt").write_text("no image")
    with pytest.raises(ValueError, match="there is no content folder"):
        pair(tmp_path / "absent", style, stylized)
    with pytest.raises(ValueError, match=r"the style folder .*empty holds no image"):
        pair(content, tmp_path / "empty", stylized)
    with pytest.raises(ValueError, match=r"the stylized folder .*words holds no image"):
        pair(content, style, tmp_path / "words")
    picture(stylized / "one" / "a_0.jpg", 0)
    with pytest.raises(ValueError, match="are the same image of the stylized folder; keep one of them"):
        pair(content, style, stylized)


def test_sizes_that_differ_and_files_that_cannot_be_read(tmp_path):
    content, style, stylized = folders(tmp_path)
    picture(stylized / "one" / "a_1.png", 0, size=(14, 8))
    first, second, *_ = pair(content, style, stylized).cells
    with pytest.raises(ValueError, match=r"a_1\.png has 14x8 pixels and .*a_0\.png 12x8; .* need one size"):
        Reader()(first)
    for frame in range(3):
        picture(stylized / "one" / f"b_{frame}.png", 0, size=(24, 16))
    with pytest.raises(ValueError, match=r"b_0\.png has 24x16 pixels and its photograph .* 12x8; give both in one"):
        Reader()(second)
    (stylized / "two" / "a_0.png").write_bytes(b"no image")
    with pytest.raises(ValueError, match=r"a_0\.png is not an image"):
        Reader()(pair(content, style, stylized).cells[2])


def test_depth_and_cameras(tmp_path):
    known, depth = folders(tmp_path, scenes=("one",)), tmp_path / "depth"
    (depth / "one").mkdir(parents=True)
    for frame in range(3):
        np.save(depth / "one" / f"{frame}.npy", np.full((8, 12), 1.0 + frame))
    given = cameras(1, 3, (8, 12))
    write_cameras(depth / "one" / "cameras.npz", ["0", "1", "2"], given)
    read = Reader()(pair(*known, depth).cells[0])
    assert read.depth.shape == (1, 3, 8, 12) and read.depth[0, 2, 0, 0] == 3
    torch.testing.assert_close(read.cameras.world_from_camera, given.world_from_camera)
    torch.testing.assert_close(read.cameras.intrinsics, given.intrinsics)
    assert read.cameras.size == (8, 12)
    np.savez(depth / "one" / "cameras.npz", poses=np.eye(4))
    with pytest.raises(ValueError, match=r"cameras\.npz is not a valid file of cameras: frames"):
        Reader()(pair(*known, depth).cells[0])
    write_cameras(depth / "one" / "cameras.npz", ["0", "1", "2"], given)
    np.save(depth / "one" / "1.npy", np.full((8, 12), np.nan))
    with pytest.raises(ValueError, match=r"1\.npy is not a valid array of finite depth"):
        Reader()(pair(*known, depth).cells[0])
    (depth / "one" / "1.npy").unlink()
    with pytest.raises(ValueError, match=r"2 of 6 .*one/a_1 \(no depth 1\)"):
        pair(*known, depth)
    pairing = pair(*known, depth, missing="allow")
    assert pairing.lacking() == "depth is missing of one/1"
    torch.testing.assert_close(Reader()(pairing.cells[0]).depth[0, :, 0, 0], torch.tensor([1.0, 0.0, 3.0]))
