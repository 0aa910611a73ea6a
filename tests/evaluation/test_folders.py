"""Which photograph and style an image belongs to, and what is said where there is none."""

import logging

import numpy as np
import pytest
import torch

from anystyle.evaluation.comparisons import Reader, write_cameras
from anystyle.evaluation.pairing import pair
from anystyle.testing.inputs import cameras
from evaluation_cases import folders, picture


def test_scenes_styles_and_frames(tmp_path):
    pairing = pair(*folders(tmp_path, frames=11))
    assert [(cell.scene, cell.style) for cell in pairing.cells] == [
        ("one", "a"), ("one", "b"), ("two", "a"), ("two", "b")
    ]  # fmt: skip
    cell = pairing.cells[2]
    assert cell.frames == tuple(str(frame) for frame in range(11))
    assert [path.name for path in cell.content] == [f"{frame:03d}.png" for frame in range(11)]
    assert cell.reference.name == "a.png"
    assert pairing.unused == ()
    read = Reader()(cell)
    assert read.content.shape == read.stylized.shape == (1, 11, 3, 8, 12)
    torch.testing.assert_close(read.stylized[0, :, 0, 0, 0] * 255, 60.0 + torch.arange(11.0))
    torch.testing.assert_close(read.content[0, :, 0, 0, 0] * 255, 100.0 + torch.arange(11.0))
    assert read.style.image.shape == (1, 3, 6, 6)
    assert (read.scenes, read.styles) == (("two",), ("a",))


def test_one_flat_folder(tmp_path):
    for frame in range(2):
        picture(tmp_path / "content" / f"{frame}.png", 1)
        picture(tmp_path / "stylized" / f"van_gogh_{frame:04d}.png", 2)
    picture(tmp_path / "style" / "van_gogh.jpg", 3)
    (cell,) = pair(tmp_path / "content", tmp_path / "style", tmp_path / "stylized").cells
    assert (cell.scene, cell.style, cell.frames) == ("", "van_gogh", ("0000", "0001"))


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
    told = str(caught.value)
    assert told.startswith("3 of 15 stylized images have no partner: ")
    for name in ("one/a_7 (no content 7)", "one/c_0 (no style c)", "three/d_9 (no content 9, no style d)"):
        assert name in told
    assert "\n" not in told


def test_what_belongs_to_nothing_is_told(tmp_path, caplog):
    content, style, stylized = folders(tmp_path)
    picture(content / "one" / "999.png", 0)
    picture(style / "unused.png", 0)
    with caplog.at_level(logging.WARNING):
        pairing = pair(content, style, stylized)
    assert pairing.unused == ("content/one/999.png", "style/unused.png")
    assert "2 images belong to no stylized image" in caplog.text


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
    with pytest.raises(ValueError, match=r"a_0\.png is no image"):
        Reader()(pair(content, style, stylized).cells[2])


def test_depth_and_cameras(tmp_path):
    known = folders(tmp_path, scenes=("one",))
    (tmp_path / "depth" / "one").mkdir(parents=True)
    for frame in range(3):
        np.save(tmp_path / "depth" / "one" / f"{frame}.npy", np.full((8, 12), 1.0 + frame))
    given = cameras(1, 3, (8, 12))
    write_cameras(tmp_path / "depth" / "one" / "cameras.npz", ["0", "1", "2"], given)
    read = Reader()(pair(*known, tmp_path / "depth").cells[0])
    assert read.depth.shape == (1, 3, 8, 12) and read.depth[0, 2, 0, 0] == 3
    torch.testing.assert_close(read.cameras.world_from_camera, given.world_from_camera)
    torch.testing.assert_close(read.cameras.intrinsics, given.intrinsics)
    assert read.cameras.size == (8, 12)
    np.savez(tmp_path / "depth" / "one" / "cameras.npz", poses=np.eye(4))
    with pytest.raises(ValueError, match=r"cameras\.npz is no file of cameras: frames"):
        Reader()(pair(*known, tmp_path / "depth").cells[0])
    write_cameras(tmp_path / "depth" / "one" / "cameras.npz", ["0", "1", "2"], given)
    np.save(tmp_path / "depth" / "one" / "1.npy", np.full((8, 12), np.nan))
    with pytest.raises(ValueError, match=r"1\.npy is no array of finite depth"):
        Reader()(pair(*known, tmp_path / "depth").cells[0])
    (tmp_path / "depth" / "one" / "1.npy").unlink()
    with pytest.raises(ValueError, match=r"2 of 6 .*one/a_1 \(no depth 1\)"):
        pair(*known, tmp_path / "depth")
