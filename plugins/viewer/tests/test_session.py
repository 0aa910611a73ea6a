"""Requests for styles, what is stored of them, and the command line that reproduces one."""

import shlex
import threading
from dataclasses import replace

import pytest
import torch
from PIL import Image

from anystyle.commands import stylize
from anystyle.contracts import Method
from anystyle.errors import UserError
from anystyle.methods.branch import Branch
from anystyle.pipeline.controls import blended, with_colors_of
from anystyle.pipeline.results import Restyler
from anystyle.pipeline.saved import read_gaussians
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Progress
from anystyle_viewer.command import View, open_session
from anystyle_viewer.picking import surface_point
from anystyle_viewer.server import MAX_SIDE, MAX_UPLOAD, store_upload, style_row, title_of
from anystyle_viewer.session import Session, StyleRequest
from anystyle_viewer.viewer import Viewer
from tests.support.browser import until
from tests.support.viewer_scene import FOCAL, SIZE, camera, write_scene

WORDS = ["views.short_side=112"]


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    return write_scene(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def restyler(file):
    session = open_session(file, WORDS)
    session.close()
    return session.restyler


@pytest.fixture
def session(restyler):
    session = Session(restyler)
    yield session
    session.close()


def settled(session, request):
    session.request(request)
    return until(lambda: session.current == request and session.gaussians)


@pytest.mark.parametrize("words", [[], ["--html", "scene.html"], ["views.take=2"]])
def test_without_an_input_one_line_says_what_to_type(words):
    with pytest.raises(UserError, match="anystyle view out/"):
        View()(words)


def test_a_saved_scene_takes_new_styles_and_going_back_costs_nothing(restyler, session):
    red, swirls = StyleRequest("red dots"), StyleRequest("thick blue swirls")
    first = settled(session, red)
    assert torch.equal(first.means, restyler.unstyled.means)
    assert not torch.equal(first.harmonics, restyler.unstyled.harmonics)
    second = settled(session, swirls)
    assert not torch.equal(first.harmonics, second.harmonics) and settled(session, red) is first
    kept = settled(session, replace(red, preserve_color=1.0))
    torch.testing.assert_close(kept.harmonics, with_colors_of(restyler.unstyled, first).harmonics)
    half = settled(session, replace(red, strength=0.5))
    torch.testing.assert_close(half.harmonics, (first.harmonics + restyler.unstyled.harmonics) / 2)
    assert settled(session, StyleRequest()) is restyler.unstyled
    between = settled(session, StyleRequest("red dots", "thick blue swirls", 0.0))
    torch.testing.assert_close(between.harmonics, first.harmonics)


def test_a_style_stays_near_where_the_ray_of_a_click_ends(restyler, session):
    red = settled(session, StyleRequest("blue waves"))
    unstyled = restyler.unstyled
    point = surface_point(unstyled, (0.0, 0.0, 0.0), (0.5, -0.4, 3.0))  # to the middle of the red half
    depth = TorchRenderer()(unstyled, camera()).depth[0, 0]  # in front of the middle by a part of its thickness
    row, column = (round(FOCAL * ratio + side / 2) for ratio, side in ((-0.4 / 3, SIZE[0]), (0.5 / 3, SIZE[1])))
    assert point[2] == pytest.approx(float(depth[row, column]), abs=0.2)
    assert surface_point(unstyled, (0.0, 0.0, 0.0), (0.0, 0.0, -1.0)) is None
    place = f"sphere:{','.join(map(str, point))},0.4"
    there = settled(session, StyleRequest("blue waves", place=place))
    near = (unstyled.means[0] - torch.tensor(point)).norm(dim=1) <= 0.4
    assert 0 < int(near.sum()) < len(near) and torch.equal(there.harmonics[0, near], red.harmonics[0, near])
    assert torch.equal(there.harmonics[0, ~near], unstyled.harmonics[0, ~near])
    assert f"--mask {place}" in session.command("photos")


class Slow(Method):
    """Takes as long as it is let; says where it is as often as it is asked."""

    def __init__(self):
        self.begun, self.go = [], threading.Event()

    def __call__(self, stylizer, scene, style, embedding, *, on_progress=lambda _: None):
        self.begun.append(style.text[0])
        while not self.go.wait(0.01):
            on_progress(Progress("step 1 of 4", 0.25))
        return Branch()(stylizer, scene, style, embedding)


def test_controls_of_a_style_that_was_painted_paint_nothing(restyler):
    method = Slow()
    method.go.set()
    session = Session(Restyler(restyler.encoded, method, keep=4))
    red, blue = StyleRequest("red dots"), StyleRequest("blue")
    for request in (red, blue, replace(red, strength=0.5), replace(blue, preserve_color=1.0)):
        settled(session, request)
    session.close()
    assert method.begun == ["red dots", "blue"]


def test_the_newest_request_ends_what_is_being_painted_and_those_between_are_never_begun(restyler):
    method, said = Slow(), []
    session = Session(Restyler(restyler.encoded, method))
    session.on_status = lambda: said.append((session.status, session.done))
    session.request(StyleRequest("first"))
    until(lambda: ("step 1 of 4", 0.25) in said)
    for style in ("second", "third"):
        session.request(StyleRequest(style))
    until(lambda: "third" in method.begun or "second" in method.begun)
    session.request(StyleRequest("fourth"))
    until(lambda: "fourth" in method.begun)
    method.go.set()
    until(lambda: session.current.style == "fourth")
    session.close()
    assert "second" not in method.begun or "third" not in method.begun
    assert session.recent == ["fourth"]


def test_a_bug_of_a_method_is_said_and_logged_and_the_next_style_is_painted(restyler, caplog):
    class Broken(Branch):
        def __call__(self, stylizer, scene, style, *others, **more):
            if style.text[0] == "broken":
                raise RuntimeError("a bug")
            return super().__call__(stylizer, scene, style, *others, **more)

    session = Session(Restyler(restyler.encoded, Broken()))
    session.request(StyleRequest("broken"))
    until(lambda: session.status == "a bug")
    assert "Traceback" in caplog.text
    settled(session, StyleRequest("red dots"))
    session.close()


def test_saved_styles_are_scenes_that_controls_and_mixtures_hold_for(restyler, tmp_path):
    one, other = (replace(restyler.unstyled, harmonics=restyler.unstyled.harmonics * factor) for factor in (0.5, -1.0))
    session = Session(restyler, saved={"starry_night": one, "other": other}, folder=tmp_path)
    assert session.wanted.style == "other" and until(lambda: session.gaussians is other)  # as a page opens
    assert settled(session, StyleRequest("starry_night")) is one
    assert session.command("out/") == "# made from results in out/"
    half = settled(session, StyleRequest("starry_night", strength=0.5))
    torch.testing.assert_close(half.harmonics, blended(restyler.unstyled, one, 0.5).harmonics)
    mixed = settled(session, StyleRequest("starry_night", "other", 0.25))
    torch.testing.assert_close(mixed.harmonics, torch.lerp(one.harmonics, other.harmonics, 0.25))
    session.close()
    elsewhere = Session(restyler, folder=tmp_path)  # another scene, to which their titles would be texts
    assert elsewhere.recent == [] and elsewhere.wanted == StyleRequest()
    elsewhere.close()


def test_what_cannot_be_painted_is_said_and_changes_nothing(restyler, session):
    session.request(StyleRequest("word " * 1000))
    until(lambda: "characters" in session.status)
    assert session.current == StyleRequest() and session.gaussians is restyler.unstyled and session.in_progress is None


def test_a_style_stays_near_its_place_after_the_next_start(restyler, tmp_path):
    with Viewer(Session(restyler, folder=tmp_path), tmp_path, ("scene.ply", [])) as viewer:
        viewer._point, viewer.reach.value = (0.25, -0.5, 3.0), 0.45
        viewer.request("red dots")
        wanted = viewer.session.wanted
        until(lambda: viewer.session.current == wanted)
    with Viewer(Session(restyler, folder=tmp_path), tmp_path, ("scene.ply", [])) as viewer:
        viewer.request("green")
        assert viewer.session.wanted == replace(wanted, style="green") and "sphere:0.25,-0.5,3," in wanted.place


def test_closing_loses_nothing_and_a_damaged_memory_is_no_obstacle(restyler, tmp_path):
    session = Session(restyler, folder=tmp_path)
    settled(session, StyleRequest("red dots"))
    settled(session, StyleRequest("thick blue swirls", strength=0.5))
    session.close()
    again = Session(restyler, folder=tmp_path)
    until(lambda: again.current == StyleRequest("thick blue swirls", strength=0.5))
    assert again.recent == ["thick blue swirls", "red dots"]
    again.folder = tmp_path / "session.json" / "nowhere"  # as where a disk is full: what is painted is shown
    settled(again, StyleRequest("green"))
    until(lambda: "this style is not kept for the next start" in again.status)
    again.close()
    for damage in ("[", '{"recent": 3}', "null", '{"request": {"style": "ink", "place": "sphere:bad"}}'):
        (tmp_path / "session.json").write_text(damage)
        with Viewer(Session(restyler, folder=tmp_path), tmp_path, ("scene.ply", [])) as blank:
            assert blank.session.recent == [] and blank.session.current == StyleRequest()


@pytest.mark.parametrize(
    "controls",
    [
        {},
        {"strength": 0.35, "preserve_color": 1.0},
        {"second": "charcoal drawing", "amount": 0.25},
        {"style": "", "strength": 1.0},
    ],
)
def test_the_command_line_makes_what_is_shown(controls, file, session, tmp_path, monkeypatch):
    shown = settled(session, replace(StyleRequest("it's red dots"), **controls))
    command = shlex.split(session.command(str(file), WORDS))
    assert command[:2] == ["anystyle", "stylize"]
    monkeypatch.chdir(tmp_path)
    stylize.main([*command[2:], "video.frames=2"])
    result = read_gaussians(tmp_path / command[command.index("--out") + 1] / "scene.safetensors")
    assert torch.equal(result.means, shown.means)
    torch.testing.assert_close(result.harmonics, shown.harmonics, rtol=0, atol=1e-6)


def test_a_picture_is_kept_once_and_another_of_its_name_beside_it(tmp_path, restyler):
    for color in ("red", "blue"):
        Image.new("RGB", (9000, 8), color).save(tmp_path / f"{color}.jpg")
    kept = [store_upload(tmp_path / "kept", "My *sky*.jpg", (tmp_path / f"{color}.jpg").read_bytes())
            for color in ("red", "blue", "red")]  # fmt: skip
    assert kept[0] == kept[2] != kept[1] and [title_of(str(path)) for path in kept[:2]] == ["My--sky-", "My--sky--2"]
    with Image.open(kept[0]) as picture:
        assert max(picture.size) < 2 * MAX_SIDE
    for content in (b"no picture", bytes(MAX_UPLOAD + 1), b""):
        with pytest.raises(ValueError):
            store_upload(tmp_path / "kept", "x.png", content)
    assert sorted((tmp_path / "kept").iterdir()) == sorted(set(kept))
    session = Session(restyler, folder=tmp_path / "kept")
    settled(session, StyleRequest(str(kept[0])))
    assert f"--image {kept[0]}" in session.command("x") and list(session.pictures()) == [title_of(str(kept[0]))]
    assert session.image_file(f"elsewhere/{kept[0].name}") == kept[0]  # of before the folder was moved
    # Another file of this machine is a text like any other.
    assert session.image_file(str(tmp_path / "red.jpg")) is None and session.image_file("../red.jpg") is None
    session.close()


def test_a_row_escapes_what_is_typed():
    assert "<b" not in style_row(["", '<b a="1">'], '<b a="1">', {"": "data:x"}).replace("<button", "")
