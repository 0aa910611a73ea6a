"""Cameras that lie beside photographs are used without being asked for; photographs without one are left out."""

import json
import re
from pathlib import Path
from unittest.mock import Mock

import numpy as np
import pytest

from anystyle import stylize
from anystyle.data.folder import read_views
from anystyle.pipeline import cameras
from anystyle.pipeline.options import PoseOptions, ViewOptions
from anystyle.pipeline.photographs import _stored_beside
from tests.support.pictures import save

SMALL = ViewOptions(short_side=56)


@pytest.fixture
def capture(tmp_path):
    """Six photographs of noise, which no search finds cameras of, with those of five in a COLMAP model."""
    random = np.random.default_rng(0)
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    lines = []
    for number in range(6):
        name = f"{number:04d}.png"
        save(tmp_path / "images" / name, random.integers(0, 255, (60, 80, 3), dtype=np.uint8))
        if number != 3:
            lines += [f"{number + 1} 1 0 0 0 {-0.1 * number} 0 0 1 {name}", ""]
    model = tmp_path / "sparse" / "0"
    (model / "images.txt").write_text("\n".join(lines) + "\n")
    (model / "cameras.txt").write_text("1 PINHOLE 80 60 70 70 40 30\n")
    (model / "points3D.txt").write_text("")
    return tmp_path


@pytest.mark.parametrize("use", ["auto", "known"])
def test_cameras_beside_are_used_and_photographs_without_are_named(capture, caplog, monkeypatch, use):
    monkeypatch.setattr(cameras, "read_poses", read := Mock(side_effect=cameras.read_poses))
    options = {"poses": PoseOptions(use), "reconstruction": "feedforward", "views": SMALL}
    encoded = stylize(capture, "blue ink", model="tiny", **options).encoded
    assert [source.name for source in encoded.sources] == ["0000", "0001", "0002", "0004", "0005"]
    centres = encoded.cameras.world_from_camera[0, :, 0, 3]
    np.testing.assert_allclose(centres.diff() / centres.diff()[0], [1, 1, 2, 1], atol=1e-4)
    assert "1 of 6 photographs have no stored camera and are left out: 0003" in caplog.text
    assert ("cameras of 5 of 6 photographs are stored beside them, and are used" in caplog.text) == (use == "auto")
    assert read.call_count == 1


def test_cameras_of_few_photographs_are_named_and_not_used(capture, caplog):
    lines = (capture / "sparse" / "0" / "images.txt").read_text().splitlines()
    (capture / "sparse" / "0" / "images.txt").write_text("\n".join(lines[:2]) + "\n")
    encoded = stylize(capture, "blue ink", model="tiny", reconstruction="feedforward", views=SMALL).encoded
    assert len(encoded.sources) == 6
    assert "cameras of 1 of 6 photographs are stored beside them, and are not used, for they are too few" in caplog.text


def test_a_damaged_file_of_cameras_is_named_and_not_used(capture, caplog):
    (capture / "sparse" / "0" / "images.txt").unlink()
    (capture / "transforms.json").write_text(json.dumps({"frames": 3}))
    encoded = stylize(capture, "blue ink", model="tiny", reconstruction="feedforward", views=SMALL).encoded
    assert len(encoded.sources) == 6 and "cameras beside the photographs are not used: " in caplog.text


UNREAD = {
    "cams/00000000_cam.txt": "MVSNet's; give the COLMAP model", "bundle.out": "Bundler's; kapture's kapture_import_b",
    "images/cameras.sfm": "Meshroom's; aliceVision_exportColmap", "sfm.json": "Meshroom's; aliceVision_exportColmap",
    "opensfm/reconstruction.json": "OpenSfM's; opensfm export_colmap",
    "images/out/sfm_data.json": "OpenMVG's; openMVG_main_openMVG2Colmap", "project.psx": "Metashape; File > Export >",
    "shots.xml": "Metashape's; export a COLMAP model, or ns-process-data metashape --data PHOTOS --xml FILE",
    "keyframes/corrected_cameras/1.json": "Polycam's raw data; ns-process-data polycam --data FOLDER",
    "database.db": "COLMAP's features without a model; colmap mapper", "images.bin": "half of a COLMAP model; copy its",
    "images/0000.xmp": "RealityScan's; export a COLMAP model",
    "images/found/transforms.json": "there are cameras in .*; poses=known poses_from=.*transforms.json uses them",
}  # fmt: skip


def test_cameras_of_the_working_directory_are_none_of_an_example(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bundle.out").write_text("# Bundle file v0.3")
    assert _stored_beside([Path("example:street")], PoseOptions("auto")) == {} and not caplog.records


@pytest.mark.parametrize(("file", "words"), UNREAD.items())
def test_cameras_that_are_not_read_are_named_with_what_to_do(capture, caplog, file, words):
    (capture / "sparse").rename(capture.parent / f"{capture.name} elsewhere")
    (capture / file).parent.mkdir(exist_ok=True, parents=True)
    (capture / "notes.xml").write_text("<document><page/></document>")
    (capture / "images" / "0001.xmp").write_text("<rdf:Description crs:Version='16.0'/>")  # a photograph's development
    (capture / file).write_text('{"xmlns:xcr": "http://www.capturingreality.com/ns/xcr/1.1#", "a": "<sensors>"}')
    assert _stored_beside([capture / "images"], PoseOptions("auto")) == {}
    assert re.search(words, caplog.text) and len(caplog.records) == 1 and str(capture / file) in caplog.text
    views, sources = read_views([capture / "images"], short_side=28, multiple=14, max_views=8)
    with pytest.raises(ValueError, match=words):
        cameras.from_files(views, sources)
