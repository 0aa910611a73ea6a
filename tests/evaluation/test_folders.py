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
from tests.support.evaluation_cases import folders
from tests.support.pictures import picture
from tests.support.refusals import raises_line


def test_scenes_styles_and_frames(tmp_path):
    pairing = pair(*folders(tmp_path, frames=11))
    assert [(cell.scene, cell.style) for cell in pairing.cells] == [
        ("one", "a"), ("one", "b"), ("two", "a"), ("two", "b")
    ]  # fmt: skip
    cell = pairing.cells[2]
    assert cell.frames == tuple(f"{frame:03d}" for frame in range(11))
    assert [path.name for path in cell.content] == [f"{frame:03d}.png" for frame in range(11)]
    assert cell.reference.name == "a.png" and pairing.lacking() == ""
    read = Reader()(cell)
    assert read.content.shape == read.stylized.shape == (1, 11, 3, 8, 12)
    torch.testing.assert_close(read.stylized[0, :, 0, 0, 0] * 255, 60.0 + torch.arange(11.0))
    torch.testing.assert_close(read.content[0, :, 0, 0, 0] * 255, 100.0 + torch.arange(11.0))
    assert read.style.image.shape == (1, 3, 6, 6) and (read.scenes, read.styles) == (("two",), ("a",))


def test_what_has_no_partner_is_listed(tmp_path):
    content, style, stylized = folders(tmp_path)
    for name in ("one/a_7.png", "one/c_0.png", "three/d_9.png"):
        picture(stylized / name, 0)
    with pytest.raises(ValueError) as caught:
        pair(content, style, stylized)
    assert str(caught.value) == (
        "3 of 15 stylized images have no partner: one/a_7 (no photograph 7), one/c_0 (no style c), "
        "three/d_9 (no scene three, no style d); they are read as {scene}/{style}_{frame}"
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


@pytest.mark.parametrize(
    ("name", "layout"),
    [
        ("wave/frame_00001", None),
        ("Wave/frame_1", None),
        ("wave_frame_00001", "{style}_{frame}"),
        ("frame_1", "{frame}"),
        ("model/test/ours_30000/renders/frame_1", "model/test/ours_*/renders/{frame}"),
    ],
)
@pytest.mark.parametrize("scene", ["", "one/"])
def test_one_scene_needs_no_folder_and_one_style_no_name(tmp_path, name, layout, scene):
    picture(tmp_path / "content" / scene / "frame_00001.png", 1)
    picture(tmp_path / "stylized" / f"{name}.png", 2)
    picture(tmp_path / "style" / "wave.jpg", 3)
    (cell,) = pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized", layout=layout).cells
    assert (cell.scene, cell.style, cell.content[0].stem) == (scene.rstrip("/"), "wave", "frame_00001")


def test_two_readings_are_told_with_what_to_type(tmp_path):
    for name in ("content/one/1", "content/one/b_1", "style/a", "style/a_b", "stylized/one/a_b_1"):
        picture(tmp_path / f"{name}.png", 0)
    with pytest.raises(
        UserError, match=r"^one/a_b_1 may be one/a/b_1 or one/a_b/1; name it so, and the others likewise$"
    ):
        pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized", missing="allow")


LAYOUTS = [
    "{style}/{scene}/{frame}",
    "{style}/{scene}_{frame}",
    "{scene}/{frame}/{style}",
    "{scene}/{style}-{frame}",
    "{scene}_{style}_{frame}",
    "nnfm/{scene}/{style}/{frame}",
    # 3DGS and its forks, gsplat, nerfstudio, ARF, StyleID: docs/protocol.md
    "{scene}/{style}/train/ours_30000/renders/{frame}",
    "{scene}/{style}/renders/val_step29999_{frame}",
    "{scene}/{style}/test/rgb/{frame}",
    "{scene}_{style}/test_renders/{frame}",
    "{scene}/{frame}_stylized_{style}",
]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_another_layout_is_refused_with_what_to_type_and_then_read(tmp_path, layout):
    for scene, style, frame in product(("one", "two"), ("a_b", "c"), ("f_0", "f_1")):
        picture(tmp_path / "content" / scene / f"{frame}.png", 0)
        picture(tmp_path / "style" / f"{style}.png", 0)
        for place in {layout, layout.replace("/renders/", "/gt/")}:  # 3DGS puts the photographs beside its renders
            picture(tmp_path / "stylized" / f"{place.format(scene=scene, style=style, frame=frame)}.png", 0)
    picture(tmp_path / "stylized" / "sheet.png", 0)  # is no result by these layouts
    named = tmp_path / "content", tmp_path / "style", tmp_path / "stylized"
    with pytest.raises(UserError) as caught:
        pair(*named)
    assert str(caught.value).endswith(
        f"is named {{scene}}/{{style}}/{{frame}} or {{scene}}/{{style}}_{{frame}}; give --layout '{layout}'"
    )
    pairing = pair(*named, layout=layout)
    assert [(cell.scene, cell.style, cell.frames) for cell in pairing.cells] == [
        (scene, style, ("f_0", "f_1")) for scene, style in product(("one", "two"), ("a_b", "c"))
    ]
    assert pairing.cells[0].stylized[1] == named[2] / f"{layout.format(scene='one', style='a_b', frame='f_1')}.png"


@pytest.mark.parametrize(
    ("layout", "told"),
    [
        ("{scene}/{style}", "layout={scene}/{style}: give {frame}, {style} and {scene} once each"),
        ("{scene}/{style}/{frame}_{frame}", "once each"),
        ("{scene}/{style}/{view}", "once each"),
        ("{scene}/{frame}", "there are 2 styles; name {style}, or give one of them"),
        ("{style}/{frame}", "there are 2 scenes; name {scene}, or give one of them"),
        ("x{scene}/{style}/{frame}", "is named x{scene}/{style}/{frame}; give --layout '{scene}/{style}_{frame}'"),
    ],
)
def test_a_layout_that_cannot_be_read_is_refused(tmp_path, layout, told):
    with raises_line(UserError, naming=told):
        pair(*folders(tmp_path), layout=layout)


def test_names_that_are_not_known_are_told_with_those_that_are(tmp_path):
    content, style, stylized = folders(tmp_path)
    stylized.rename(tmp_path / "old")
    picture(stylized / "one" / "xa" / "0.png", 0)
    told = "give the --layout of names such as 'one/xa/0', where there is scene 'one', style 'a', frame '000'$"
    with pytest.raises(UserError, match=told):
        pair(content, style, stylized)


def test_photographs_of_one_scene_are_not_those_of_two(tmp_path):
    content, style, stylized = folders(tmp_path)
    with pytest.raises(UserError, match=r"is named {style}/{frame}; give --layout 'one/{style}_{frame}'"):
        pair(content / "one", style, stylized)
    with pytest.raises(UserError, match=r"the photographs are of one scene, in no folder; leave out {scene}"):
        pair(content / "one", style, stylized, layout="{scene}/{style}_{frame}")


def test_folders_that_cannot_be_judged(tmp_path):
    content, style, stylized = folders(tmp_path)
    (tmp_path / "empty").mkdir()
    (tmp_path / "words").mkdir()
    (tmp_path / "words" / "a.txt").write_text("no image")
    with pytest.raises(ValueError, match="there is no content folder"):
        pair(tmp_path / "absent", style, stylized)
    with pytest.raises(ValueError, match=r"the style folder .*empty holds no image; expected STYLE\.png"):
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
    for wrong, told in (
        (np.ones((12, 8)), r"shape \[12, 8\], of another aspect than"),
        (-np.ones((8, 12)), "from -1;"),
    ):
        for frame in range(3):
            np.save(depth / "one" / f"{frame}.npy", wrong)
        with pytest.raises(ValueError, match=told):
            Reader()(pair(*known, depth).cells[0])
    for frame in range(3):
        np.save(depth / "one" / f"{frame}.npy", np.full((8, 12), 1.0 + frame))
    (depth / "one" / "1.npy").unlink()
    with pytest.raises(ValueError, match=r"^depth is missing of one/001; add them"):
        pair(*known, depth)
    pairing = pair(*known, depth, missing="allow")
    assert pairing.lacking() == "depth is missing of one/001"
    torch.testing.assert_close(Reader()(pairing.cells[0]).depth[0, :, 0, 0], torch.tensor([1.0, 0.0, 3.0]))
