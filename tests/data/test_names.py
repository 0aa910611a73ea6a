"""Which photograph another program's name is of, and names that tell photographs apart."""

from pathlib import Path

import pytest

from anystyle.data.names import differences, matched
from anystyle.paths import file_name, names_below, short_names

RIG = ["cam0/1.png", "cam1/1.png"]


def as_read(name: str, encoding: str) -> str:
    """A name as it is read from a file in another encoding than UTF-8."""
    return name.encode(encoding).decode("utf-8", "surrogateescape")


LATIN = as_read("é.png", "latin-1")


@pytest.mark.parametrize(
    ("stored", "images", "expected", "told"),
    [
        (RIG, RIG, RIG, ""),
        (["C:\\p\\cam1\\1.png", "C:\\p\\cam0\\1.png"], RIG, ["C:\\p\\cam0\\1.png", "C:\\p\\cam1\\1.png"], "folder"),
        (["cam0/1.png"], RIG, ["cam0/1.png", None], ""),  # the other was not registered
        (["cam0/1.png", "cam1/2.png"], ["cam1/1.png", "cam1/2.png"], [None, "cam1/2.png"], ""),
        (["a/b.jpg", "c/b.png"], ["a/b.png", "c/b.png"], ["a/b.jpg", "c/b.png"], "suffix"),
        (["cam0/1.png"], ["1.png"], ["cam0/1.png"], "folder"),
        (["../images_4/1.png"], ["images/1.png"], ["../images_4/1.png"], ""),
        (["a"], ["a.png"], ["a"], ""),
        (["a.png.png"], ["a.png"], ["a.png.png"], ""),
        (["a.jpg"], ["a.png"], ["a.jpg"], "suffix"),
        (["a.jpg"], ["a.png", "a.jpg"], [None, "a.jpg"], ""),
        (["A.JPG", "b.jpg"], ["a.jpg", "b.jpg"], ["A.JPG", "b.jpg"], "upper and lower case"),
        (["A.jpg", "a.jpg"], ["a.jpg", "A.jpg"], ["a.jpg", "A.jpg"], ""),
        (["cafe\u0301.png"], ["caf\u00e9.png"], ["cafe\u0301.png"], "Unicode"),
        ([as_read("照片1.png", "gbk")], ["照片1.png"], [as_read("照片1.png", "gbk")], "encoding"),
        ([as_read("联通.png", "gbk")], ["联通.png"], [as_read("联通.png", "gbk")], "encoding"),
        ([as_read("夏/ソ.png", "cp932")], ["夏/ソ.jpg"], [as_read("夏/ソ.png", "cp932")], "encoding"),
        ([LATIN, "e.png"], ["é.png", "e.png"], [LATIN, "e.png"], "encoding"),
        (["é.png"], [LATIN], ["é.png"], "encoding"),
        ([], ["a.png"], [None], ""),
    ],
)
def test_names_are_matched_where_one_image_is_meant(stored, images, expected, told):
    paths = [Path("/data/photographs", image) for image in images]
    found = matched(stored, paths)
    assert [found.get(path) for path in paths] == expected
    assert (told in differences(found)) if told else differences(found) == ""


@pytest.mark.parametrize(
    ("stored", "images", "words"),
    [
        (RIG, ["1.png"], r"/1\.png may be cam0/1\.png or cam1/1\.png"),
        (["1.png"], RIG, r"1\.png may be .*cam0/1\.png or .*cam1/1\.png"),
        (["a.tif", "a.jpg"], ["a.png"], r"/a\.png may be a\.jpg or a\.tif"),
        (["a.jpg"], ["a.png", "a.tif"], r"a\.jpg may be .*/a\.png or .*/a\.tif"),
    ],
)
def test_what_may_be_either_is_refused_with_both_names(stored, images, words):
    with pytest.raises(ValueError, match=words):
        matched(stored, [Path("/data", image) for image in images])


def test_short_names_have_as_few_folders_as_tell_them_apart():
    assert short_names([Path("/r/cam0/1"), Path("/r/cam1/1"), Path("/r/cam1/2")]) == ["cam0_1", "cam1_1", "cam1_2"]
    assert short_names([Path("a/x/1"), Path("b/x/1")]) == ["a_x_1", "b_x_1"]
    assert short_names([Path("cam0/1"), Path("cam1/2"), Path("cam1/2")]) == ["1", "2", "2_2"]
    assert names_below([Path("r/cam0/1.png"), Path("r/cam1/2.png")]) == ["cam0/1.png", "cam1/2.png"]
    assert names_below([Path("r/1.png")]) == ["1.png"] and names_below([]) == []


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("100_7103", "100_7103"),
        ("IMG 0 (1)", "IMG 0 (1)"),
        ("Schloß Ähnlich", "Schloß Ähnlich"),
        ("照片1", "照片1"),
        ("a/b\\c:d*?", "a-b-c-d-"),
        ("..", "view"),
        ("e\u0301", "\u00e9"),
        ("照" * 100, "照" * 66),
    ],
)
def test_a_file_keeps_the_name_of_its_photograph(name, kept, tmp_path):
    assert file_name(name) == kept
    (tmp_path / f"{kept}.png").touch()
    assert [path.stem for path in tmp_path.iterdir()] == [kept]
