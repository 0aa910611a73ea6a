"""What a scene was made of is in its report, with hashes that others compute; files hold licences and nothing else."""

import hashlib
import json
import subprocess

import pytest
from PIL import Image, PngImagePlugin
from plyfile import PlyData

from anystyle.commands import stylize
from tests.support.pictures import save_photographs

SMALL = ("views.short_side=28", "video.frames=2", "video.scale=0.5")


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Photographs with EXIF data, and an image of a style."""
    folder = tmp_path_factory.mktemp("hiddenplace")
    exif = Image.Exif()
    exif[0x010F] = "secretcamera"
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 51.0, 29.9), 3: "E", 4: (2.0, 17.0, 40.2)})
    save_photographs(folder, ("quillfeather_0.jpg", "quillfeather_1.jpg"), 56, 84, exif=exif)
    Image.new("RGB", (40, 30), (200, 30, 30)).save(folder.parent / "zinnober.png", exif=exif)
    return folder


@pytest.fixture(scope="module")
def results(given, tmp_path_factory):
    """A scene in two styles."""
    out = tmp_path_factory.mktemp("results")
    words = [str(given), "--text", "aquamarine dots", "--image", str(given.parent / "zinnober.png"), "--export", "html"]
    stylize.main([*words, *SMALL, "export.colmap=text", f"poses_from={given}", "--out", str(out)])
    return out


def digest(path):
    return hashlib.sha256(path.read_bytes()).hexdigest()


def test_a_report_says_what_was_given_with_hashes_that_others_compute(results, given):
    works = {work["kind"]: work for work in json.loads((results / "report.json").read_text())["provenance"]}
    names = [f"quillfeather_{number}.jpg" for number in range(2)]
    printed = subprocess.run(["sha256sum", *names], cwd=given, capture_output=True, check=True).stdout
    listed = hashlib.sha256(printed).hexdigest()
    assert works == {
        "photographs": {"kind": "photographs", "views": 2, "names": names, "sha256": listed},
        "text": {"kind": "text", "text": "aquamarine dots"},
        "image": {"kind": "image", "names": ["zinnober.png"], "sha256": digest(given.parent / "zinnober.png")},
    }
    (alone,) = results.glob("01-*/report.json")
    assert "zinnober" not in json.dumps(json.loads(alone.read_text())["provenance"])


def test_what_a_camera_wrote_into_photographs_goes_nowhere(results, given):
    """Neither the maker nor the place, as bytes of EXIF data or as text; folders are not named either."""
    files = [path for path in results.rglob("*") if path.is_file()]
    assert len(files) > 20
    for path in files:
        held = path.read_bytes()
        assert b"secretcamera" not in held and b"Exif\0" not in held and str(given).encode() not in held, path
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert isinstance(image, PngImagePlugin.PngImageFile) and image.text == {} and not image.getexif()


def test_a_file_of_others_that_is_styled_keeps_its_comments_and_is_recorded(results, tmp_path):
    (source,) = results.glob("01-*/scene.ply")
    data = PlyData.read(source)
    licences = [line for line in data.comments if "Apache-2.0" in line]
    assert len(licences) >= 3  # the backbone, the style encoder, the branch
    data.comments = ["by somebody else, CC-BY-4.0"]
    data.write(tmp_path / "theirs.ply")
    words = [str(tmp_path / "theirs.ply"), "--text", "red dots", *SMALL, "splat.cameras=2", "method.fit_colors=1"]
    stylize.main([*words, "--out", str(tmp_path / "out")])
    comments = PlyData.read(tmp_path / "out" / "scene.ply").comments
    assert "by somebody else, CC-BY-4.0" in comments and {*licences} <= {*comments}
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    scene, text = report["provenance"]
    assert scene == {"kind": "scene", "names": ["theirs.ply"], "sha256": digest(tmp_path / "theirs.ply")}
    assert text == {"kind": "text", "text": "red dots"} and report["notes"] == ["by somebody else, CC-BY-4.0"]
