"""What a scene was made of is in every file, read by other programs' readers, and in none where it may not be told."""

import gzip
import hashlib
import io
import json
import re
import shutil
import subprocess
import tempfile
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image, PngImagePlugin
from plyfile import PlyData

from anystyle.commands import export, stylize
from anystyle.pipeline.read import is_saved
from anystyle.pipeline.saved import read_saved
from anystyle.vision.weights import license_meaning

WORDS = ("aquamarine", "zinnober", "quillfeather", "hiddenplace", "secretcamera")
"""Of a text, a style image, a photograph, a folder and its EXIF data: no file may have them where nothing is told."""
SMALL = ("views.short_side=28", "video.frames=2", "video.scale=0.5")
FORMATS = "glb,html,sog,spz,splat,usda,usdz"


@pytest.fixture(scope="module")
def given(tmp_path_factory):
    """Photographs with EXIF data, and an image of a style."""
    folder = tmp_path_factory.mktemp("hiddenplace")
    exif = Image.Exif()
    exif[0x010F] = "secretcamera"
    exif.get_ifd(0x8825).update({1: "N", 2: (48.0, 51.0, 29.9), 3: "E", 4: (2.0, 17.0, 40.2)})
    pixels = np.random.default_rng(0).integers(0, 255, (56, 84, 3), dtype=np.uint8)
    for number in range(2):
        Image.fromarray(np.roll(pixels, 3 * number, 1)).save(folder / f"quillfeather_{number}.jpg", exif=exif)
    Image.new("RGB", (40, 30), (200, 30, 30)).save(folder.parent / "zinnober.png", exif=exif)
    return folder


@pytest.fixture(scope="module")
def folders(given, tmp_path_factory):
    """Results of the same styles, with provenance and without."""
    out = tmp_path_factory.mktemp("results")
    words = [str(given), "--text", "aquamarine dots", "--image", str(given.parent / "zinnober.png")]
    words += ["--export", FORMATS, *SMALL, "export.colmap=text", f"poses_from={given}"]
    stylize.main([*words, "--out", str(out / "open")])
    stylize.main([*words, "--out", str(out / "closed"), "--no-provenance"])
    return out / "open", out / "closed"


def contents(path: Path) -> bytes:
    """All that a file holds, its archives unpacked, and its name."""
    return path.name.encode() + _unpacked(path.read_bytes())


def _unpacked(data: bytes) -> bytes:
    if data[:4] == b"PK\3\4":
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return b"".join(name.encode() + _unpacked(archive.read(name)) for name in archive.namelist())
    if data[:4] == b"PXR-":  # binary USD packs its texts
        from pxr import Sdf

        with tempfile.NamedTemporaryFile(suffix=".usdc") as file:
            file.write(data)
            file.flush()
            return data + Sdf.Layer.FindOrOpen(file.name).ExportToString().encode()
    return data + (gzip.decompress(data) if data[:2] == b"\x1f\x8b" else b"")


def converted(source: Path, out: Path, *words: str) -> None:
    export.export(export.parser().parse_args([str(source), "--out", str(out), *words]))


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


class Page(HTMLParser):
    """The JSON-LD of a page."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.linked, self._inside = "", False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self._inside = tag == "script" and ("type", "application/ld+json") in attrs

    def handle_data(self, data):
        self.linked += data if self._inside else ""
        self._inside = False


def test_a_report_says_what_was_given_with_hashes_that_others_compute(folders, given):
    report = json.loads((folders[0] / "report.json").read_text())
    works = {work["kind"]: work for work in report["provenance"]}
    names = [f"quillfeather_{number}.jpg" for number in range(2)]
    printed = subprocess.run(["sha256sum", *names], cwd=given, capture_output=True, check=True).stdout
    assert works["photographs"] == {
        "kind": "photographs", "views": 2, "names": names, "sha256": hashlib.sha256(printed).hexdigest()
    }  # fmt: skip
    assert works["image"]["sha256"] == digest(given.parent / "zinnober.png")
    assert works["text"] == {"kind": "text", "text": "aquamarine dots"}
    networks = {work["part"]: work for work in report["provenance"] if work["kind"] == "network"}
    assert networks.keys() >= {"backbone", "style_encoder", "branch"}
    assert all(len(work["sha256"]) == 64 and work["license"].startswith("Apache") for work in networks.values())
    assert works["software"]["anystyle"]
    (alone,) = folders[0].glob("01-*/report.json")
    assert "zinnober" not in json.dumps(json.loads(alone.read_text())["provenance"])


@pytest.mark.parametrize("name", ["glb", "html", "ply", "sog", "usda", "usdz"])
def test_other_readers_find_it_in_a_file(name, folders, given):
    shown = folders[0] / f"scene.{name}"
    file = shown if shown.is_file() else next(folders[0].glob(f"01-*/scene.{name}"))
    if name == "glb":
        pygltflib = pytest.importorskip("pygltflib")
        document = pygltflib.GLTF2().load(str(file))
        (packet,) = document.extensions["KHR_xmp_json_ld"]["packets"]
        assert document.asset.extensions["KHR_xmp_json_ld"] == {"packet": 0}
        assert {"KHR_gaussian_splatting", "KHR_xmp_json_ld"} == {*document.extensionsUsed}
        assert (
            "quillfeather_0.jpg" in packet["dc:source"] and "zinnober" in packet["dc:description"]["rdf:_1"]["@value"]
        )
        prefixes = {key.split(":")[0] for key in packet if not key.startswith("@")}
        assert prefixes < {*packet["@context"]} and "Apache-2.0" in document.asset.copyright
        found = document.asset.extras["provenance"]
    elif name == "html":
        linked = json.loads(Page(file.read_text(encoding="utf-8")).linked)
        assert linked["@type"] == "3DModel" and "Apache-2.0" in linked["usageInfo"]
        found = linked["isBasedOn"]
    elif name == "ply":
        tables = [line.removeprefix("made of ") for line in PlyData.read(file).comments if line.startswith("made of ")]
        found = [json.loads(table) for table in tables]
    elif name == "sog":
        with zipfile.ZipFile(file) as archive:
            found = json.loads(archive.read("meta.json"))["asset"]["provenance"]
    else:
        pxr = pytest.importorskip("pxr.Usd")
        stage = pxr.Stage.Open(str(file))  # a layer lives as long as its stage
        layer = stage.GetRootLayer()
        assert "quillfeather_0.jpg" in layer.documentation and "Apache-2.0" in layer.documentation
        found = json.loads(layer.customLayerData["provenance"])
    text = json.dumps(found)
    image = digest(given.parent / "zinnober.png")
    assert "aquamarine dots" in text and (image in text) == (file == shown) and "magenta_text.safetensors" in text
    assert str(given) not in text


def test_nothing_is_told_where_it_may_not_be(folders, given):
    """Names and texts are in no file and no file's name; hashes of what was given are not either."""
    told, untold = ([path for path in folder.rglob("*") if path.is_file()] for folder in folders)
    pictures = [path for path in told if path.name == "style.jpg"]
    assert len(pictures) == 1 and len(told) == len(untold) + 1 >= 40
    assert [b"data:image" in (folder / "scene.html").read_bytes() for folder in folders] == [True, False]
    everything = b"".join(map(contents, told)).lower()
    for word in WORDS[:3]:
        assert word.encode() in everything
    hashes = [digest(given.parent / "zinnober.png"), *re.findall(rb"\b[0-9a-f]{64}\b", everything)]
    secrets = [*WORDS, *(each if isinstance(each, str) else each.decode() for each in hashes)]
    for path in untold:
        held = contents(path).lower()
        assert [word for word in secrets if word.encode() in held] == [], path
        assert not any(word in str(path.relative_to(folders[1])) for word in WORDS)
    report = json.loads((folders[1] / "report.json").read_text())
    assert report["style"] == ["style 1", "style 2"] and report["gaussians"] > 0 and report["seed"] == 0
    assert [path.name for path in sorted(folders[1].glob("0*"))] == ["01-style-1", "02-style-2"]
    assert len(read_saved(folders[1]).styles) == 3


def test_what_a_camera_wrote_into_photographs_goes_nowhere(folders, given):
    """Neither the maker nor the place, as bytes of EXIF data or as text; folders are not named either."""
    for path in [path for path in folders[0].rglob("*") if path.is_file()]:
        held = contents(path)
        assert b"secretcamera" not in held and b"Exif\0" not in held and str(given).encode() not in held, path
        if path.suffix == ".png":
            with Image.open(path) as image:
                assert isinstance(image, PngImagePlugin.PngImageFile) and image.text == {} and not image.getexif()


@pytest.mark.parametrize("name", ["ply", "glb", "usdz", "spz", "sog", "splat"])
def test_it_travels_on_from_any_file_until_it_may_not(name, folders, tmp_path, capsys):
    source = next(iter([*folders[0].glob(f"scene.{name}"), *folders[0].glob(f"01-*/scene.{name}")]))
    assert is_saved(source)
    for other in ("glb", "spz"):
        out = tmp_path / f"other.{other}"
        converted(source, out)
        beside = tmp_path / f"other.{other}.txt"
        text = contents(out) + (contents(beside) if beside.is_file() else b"")
        assert b"quillfeather_1.jpg" in text and b"aquamarine dots" in text and b"Apache-2.0" in text
        converted(source, out, "--no-provenance")
        assert not beside.is_file() and not any(word.encode() in contents(out) for word in (*WORDS, "Apache"))


def test_licences_that_bind_results_stay(folders, tmp_path):
    (source,) = folders[0].glob("01-*")
    shutil.copytree(source, tmp_path / "out")
    report = json.loads((source / "report.json").read_text())
    report["licenses"]["branch"] |= {"license": "CC-BY-NC-4.0", "means": license_meaning("CC-BY-NC-4.0")}
    (tmp_path / "out" / "report.json").write_text(json.dumps(report))
    converted(tmp_path / "out", tmp_path / "other.ply", "--no-provenance")
    licence, axis = PlyData.read(tmp_path / "other.ply").comments
    assert licence.startswith("branch: ") and "CC-BY-NC-4.0" in licence and axis.startswith("Vertical axis")


@pytest.mark.slow
def test_a_file_of_others_that_is_styled_is_named_with_its_comments(folders, given, tmp_path):
    (source,) = folders[0].glob("01-*/scene.ply")
    data = PlyData.read(source)
    data.comments = ["by somebody else, CC-BY-4.0"]
    data.write(tmp_path / "theirs.ply")
    words = [str(tmp_path / "theirs.ply"), "--text", "red dots", *SMALL, "splat.cameras=2", "method.fit_colors=1"]
    stylize.main([*words, "--out", str(tmp_path / "out")])
    comments = PlyData.read(tmp_path / "out" / "scene.ply").comments
    assert "by somebody else, CC-BY-4.0" in comments
    assert any(digest(tmp_path / "theirs.ply") in line for line in comments)
    stylize.main([*words, "--out", str(tmp_path / "closed"), "--no-provenance"])
    hidden = PlyData.read(tmp_path / "closed" / "scene.ply").comments
    assert not any("somebody" in line or "theirs" in line for line in hidden)
