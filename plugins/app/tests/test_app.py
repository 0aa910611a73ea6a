"""The app without its page: scenes in folders of their own, what is said of them, and lines of errors."""

import re
import socket
import sys
import zipfile
from types import ModuleType

import pytest
import torch

from anystyle.errors import MissingExtra, UserError
from anystyle.pipeline.saved import read_gaussians
from anystyle.types import Progress
from anystyle_app import command
from anystyle_app.making import Maker, files_of
from anystyle_app.markup import said, shown
from tests.support.viewer_scene import write_scene

PHOTOGRAPHS = ["poses=predicted", "reconstruction=feedforward", "views.take=3", "views.short_side=112"]
SPLAT = ["model=tiny", "splat.cameras=2", "views.short_side=112"]
VIDEO = "video.frames=4"


def test_photographs_in_a_style_that_no_word_is_known_of(tmp_path):
    maker, stages = Maker(tmp_path / "out", [*PHOTOGRAPHS, VIDEO]), []
    with maker.working() as warnings:
        folder = maker.make(["example:street"], "zorblax", report=lambda stage, progress: stages.append(stage))
    assert folder == tmp_path / "out" / "street_zorblax"
    assert list(dict.fromkeys(stages)) == ["load", "embed", "read", "encode", "render", "restyle", "write"]
    assert "never learnt: zorblax" in warnings[0] and "<p>of the style &#x27;zorblax&#x27;" in said(warnings)
    files = files_of(folder)
    assert [path.name for path in files.values()] == ["scene.html", "scene.ply", "video.mp4", "street_zorblax.zip"]
    named = zipfile.ZipFile(files["All files"]).namelist()
    assert {f"street_zorblax/{name}" for name in ("scene.ply", "scene.html", "video.mp4", "report.json")} <= {*named}
    links = [f"made/street_zorblax/{path.name}" for path in files.values()]
    assert re.findall('href="([^"]*)" download', shown(folder)) == links


def test_nothing_is_deleted_by_making_it_again(tmp_path):
    splat, maker = write_scene(tmp_path), Maker(tmp_path / "out", [*SPLAT, VIDEO])
    first = maker.make([str(splat)], "red dots")
    before = {path: path.read_bytes() for path in (*first.rglob("*.*"), *first.parent.glob("*.zip")) if path.is_file()}
    second = maker.make([str(splat)], "red dots", strength=0.0)
    assert [first.name, second.name] == ["scene_red-dots", "scene_red-dots-2"]
    assert {path: path.read_bytes() for path in before} == before
    assert maker.made() == [second.name, first.name]
    colors = [read_gaussians(folder / "scene.safetensors").harmonics for folder in (first, second)]
    assert not torch.equal(*colors)


def test_stopping_and_closing_leave_nothing(tmp_path):
    splat, out = write_scene(tmp_path), tmp_path / "out"
    maker = Maker(out, SPLAT)

    def stop(stage: str, progress: Progress) -> None:
        if stage == "encode":
            maker.unwanted.add("mine")

    with pytest.raises(UserError, match="stopped"):
        maker.make([str(splat)], "red dots", report=stop, session="mine")
    assert not out.exists() or list(out.iterdir()) == []
    with pytest.raises(UserError, match="stopped"):
        maker.make([str(splat)], "red dots", report=lambda stage, progress: setattr(maker, "_closed", True))
    assert maker.made() == []


@pytest.mark.parametrize(
    ("inputs", "style", "more", "line"),
    [
        ([], "red dots", {}, "no photographs are given"),
        (["nowhere.jpg"], "red dots", {}, "nowhere.jpg"),
        (["example:street"], " ", {}, "is empty"),
        (["example:street"], "red dots", {"method": "brushes"}, "brushes"),
    ],
)
def test_what_cannot_be_made_is_one_line(tmp_path, inputs, style, more, line):
    with pytest.raises(UserError, match=line):
        Maker(tmp_path / "out").make(inputs, style, **more)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("host", "reason"), [("127.0.0.1", "in use"), ("203.0.113.1", "assign")])
def test_an_address_that_cannot_be_had_is_one_line(monkeypatch, host, reason):
    monkeypatch.setitem(sys.modules, "gradio", ModuleType("gradio"))
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError, match=f"cannot answer at {host}, port {port}: .*{reason}"):
            command.App()(["--host", host, "--port", str(port)])


def test_without_gradio_one_line_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "gradio", None)
    with pytest.raises(MissingExtra, match=re.escape('pip install "anystyle[app]"')):
        command.App()([])
