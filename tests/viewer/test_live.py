"""What the viewer remembers, its door, and the command line that it says."""

import http.client
import shlex
import threading
from dataclasses import replace

import pytest
import torch
from PIL import Image

from anystyle.commands._compose import main
from anystyle.commands.stylize import parser, stylize
from anystyle.inference.controls import blended, with_colors_of
from anystyle.inference.results import Controlled
from anystyle.inference.saved import read_gaussians
from anystyle.methods.contract import Method, Progress
from anystyle.viewer.door import Door, judged, new_token
from anystyle.viewer.page import LARGEST, LONGEST, keep_picture, name_of, row
from anystyle.viewer.session import Session, Wish
from chromium import until
from viewer.worlds import WORDS, world_in


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return world_in(tmp_path_factory.mktemp("scene"))


@pytest.fixture(scope="module")
def opened(world):
    return world.opened


@pytest.fixture
def session(opened):
    session = Session(opened.controlled)
    yield session
    session.close()


def settled(session, wish):
    session.ask(wish)
    return until(lambda: session.shown == wish and session.gaussians)


def test_a_saved_scene_takes_new_styles_and_going_back_costs_nothing(opened, session):
    red, swirls = Wish("red dots"), Wish("thick blue swirls")
    first = settled(session, red)
    assert torch.equal(first.means, opened.unstyled.means)
    assert not torch.equal(first.harmonics, opened.unstyled.harmonics)
    second = settled(session, swirls)
    assert not torch.equal(first.harmonics, second.harmonics)
    assert settled(session, red) is first
    kept = settled(session, replace(red, preserve_color=1.0))
    torch.testing.assert_close(kept.harmonics, with_colors_of(opened.unstyled, first).harmonics)
    half = settled(session, replace(red, strength=0.5))
    torch.testing.assert_close(half.harmonics, (first.harmonics + opened.unstyled.harmonics) / 2)
    assert settled(session, Wish()) is opened.unstyled
    between = settled(session, Wish("red dots", "thick blue swirls", 0.0))
    torch.testing.assert_close(between.harmonics, first.harmonics)


class Slow(Method):
    """Takes as long as it is let; says where it is as often as it is asked."""

    def __init__(self):
        self.begun, self.go = [], threading.Event()

    def __call__(self, stylizer, scene, style, embedding, *, on_progress=lambda _: None):
        self.begun.append(style.text[0])
        while not self.go.wait(0.01):
            on_progress(Progress("step 1 of 4", None, 0.25))
        return stylizer.restyle(scene, embedding)


def test_controls_of_a_style_that_was_painted_paint_nothing(opened):
    method = Slow()
    method.go.set()
    session = Session(Controlled(opened.controlled.encoded, method, keep=4))
    for wish in (Wish("red dots"), Wish("blue"), Wish("red dots", strength=0.5), Wish("blue", preserve_color=1.0)):
        settled(session, wish)
    session.close()
    assert method.begun == ["red dots", "blue"]


def test_the_newest_wish_ends_what_is_being_painted_and_those_between_are_never_begun(opened):
    method, said = Slow(), []
    session = Session(Controlled(opened.controlled.encoded, method))
    session.on_status = lambda: said.append((session.painting and session.painting.style, session.status, session.done))
    session.ask(Wish("first"))
    until(lambda: ("first", "step 1 of 4", 0.25) in said)
    for style in ("second", "third"):
        session.ask(Wish(style))
    until(lambda: "third" in method.begun or "second" in method.begun)
    session.ask(Wish("fourth"))
    until(lambda: "fourth" in method.begun)
    method.go.set()
    until(lambda: session.shown.style == "fourth")
    session.close()
    assert "second" not in method.begun or "third" not in method.begun
    assert session.recent == ["fourth"]


def test_saved_styles_are_scenes_that_controls_and_mixtures_hold_for(opened):
    one, other = (replace(opened.unstyled, harmonics=opened.unstyled.harmonics * factor) for factor in (0.5, -1.0))
    session = Session(opened.controlled, saved={"starry_night": one, "other": other})
    assert settled(session, Wish("starry_night")) is one
    assert session.command("out/") == "# made of results in out/"
    half = settled(session, Wish("starry_night", strength=0.5))
    torch.testing.assert_close(half.harmonics, blended(opened.unstyled, one, 0.5).harmonics)
    mixed = settled(session, Wish("starry_night", "other", 0.25))
    torch.testing.assert_close(mixed.harmonics, torch.lerp(one.harmonics, other.harmonics, 0.25))
    session.close()


def test_what_cannot_be_painted_is_said_and_changes_nothing(opened, session):
    session.ask(Wish("word " * 1000))
    until(lambda: "characters" in session.status)
    assert session.shown == Wish() and session.gaussians is opened.unstyled and session.painting is None


def test_closing_loses_nothing_and_a_damaged_memory_is_no_obstacle(opened, tmp_path):
    session = Session(opened.controlled, folder=tmp_path)
    settled(session, Wish("red dots"))
    settled(session, Wish("thick blue swirls", strength=0.5))
    session.close()
    again = Session(opened.controlled, folder=tmp_path)
    until(lambda: again.shown == Wish("thick blue swirls", strength=0.5))
    assert again.recent == ["thick blue swirls", "red dots"]
    again.close()
    for damage in ("[", '{"recent": 3}', "null"):
        (tmp_path / "session.json").write_text(damage)
        blank = Session(opened.controlled, folder=tmp_path)
        assert blank.recent == [] and blank.shown == Wish()
        blank.close()


@pytest.mark.parametrize(
    "controls",
    [
        {},
        {"strength": 0.35, "preserve_color": 1.0},
        {"second": "charcoal drawing", "amount": 0.25},
        {"style": "", "strength": 1.0},
    ],
)
def test_the_command_line_makes_what_is_shown(controls, world, session, tmp_path, monkeypatch):
    wish = replace(Wish("it's red dots"), **controls)
    shown = settled(session, wish)
    command = shlex.split(session.command(str(world.path), WORDS))
    assert command[:2] == ["anystyle", "stylize"]
    monkeypatch.chdir(tmp_path)
    main("stylize", stylize, parser(), [*command[2:], "video.frames=2"])
    result = read_gaussians(tmp_path / command[command.index("--out") + 1] / "scene.safetensors")
    assert torch.equal(result.means, shown.means)
    torch.testing.assert_close(result.harmonics, shown.harmonics, rtol=0, atol=1e-6)


def test_a_picture_is_kept_once_and_another_of_its_name_beside_it(tmp_path, opened):
    for color in ("red", "blue"):
        Image.new("RGB", (9000, 8), color).save(tmp_path / f"{color}.jpg")
    kept = [keep_picture(tmp_path / "kept", "My *sky*.jpg", (tmp_path / f"{color}.jpg").read_bytes())
            for color in ("red", "blue", "red")]  # fmt: skip
    assert kept[0] == kept[2] != kept[1] and [name_of(str(path)) for path in kept[:2]] == ["My--sky-"] * 2
    with Image.open(kept[0]) as picture:
        assert max(picture.size) < 2 * LONGEST
    for content in (b"no picture", bytes(LARGEST + 1), b""):
        with pytest.raises(ValueError) as error:
            keep_picture(tmp_path / "kept", "x.png", content)
        assert ".given" not in str(error.value)
    assert sorted((tmp_path / "kept").iterdir()) == sorted(set(kept))
    session = Session(opened.controlled, folder=tmp_path / "kept")
    settled(session, Wish(str(kept[0])))
    assert f"--image {kept[0]}" in session.command("x")
    # Another file of this machine is a text like any other.
    assert session.picture(str(tmp_path / "red.jpg")) is None and session.picture("../red.jpg") is None
    session.close()


def test_a_row_says_what_is_shown_and_nothing_that_is_typed_is_html():
    html = row(["", '<b a="1">'], '<b a="1">', {"": "data:x"})
    assert "<b" not in html.replace("<button", "") and html.count("<button") == 2
    assert html.index('aria-pressed="false"') < html.index('aria-pressed="true"')


def head(path="/", **headers):
    lines = [f"GET {path} HTTP/1.1", *(f"{name.replace('_', '-')}: {value}" for name, value in headers.items())]
    return ("\r\n".join(lines) + "\r\n\r\n").encode()


@pytest.mark.parametrize(
    ("request_head", "token", "status"),
    [
        (head(Host="127.0.0.1:8080"), None, ""),
        (head(Host="localhost:8080", Origin="http://localhost:8080"), None, ""),
        (head(Host="evil.example:8080"), None, "421"),  # a name that leads here
        (head(Host="127.0.0.1:8080", Origin="http://evil.example"), None, "403"),  # a page elsewhere
        (head(Host="127.0.0.1:8080", Origin="http://127.0.0.1:9999"), None, "403"),
        (b"PUT / HTTP/1.1\r\nHost: localhost\r\n\r\n", None, "405"),
        (b"POST /style HTTP/1.1\r\nHost: localhost\r\n\r\n", None, "403"),  # browsers say where from
        (b"POST /style HTTP/1.1\r\nHost: localhost\r\nOrigin: http://localhost\r\n\r\n", None, ""),
        (b"POST /style HTTP/1.1\r\nHost: localhost\r\nOrigin: http://evil.example\r\n\r\n", None, "403"),
        (b"POST /style HTTP/1.1\r\nHost: a\r\nOrigin: http://a\r\n\r\n", "secret", "403"),
        (b"\xff\xfe\r\n\r\n", None, "405"),
        (head(Host="my.machine"), "secret", "403"),
        (head("/?token=wrong", Host="my.machine"), "secret", "403"),
        (head("/?token=secret", Host="my.machine"), "secret", "303"),
        (head(Host="my.machine", Cookie="a=b; anystyle_view=secret"), "secret", ""),
        (head(Host="my.machine", Cookie="anystyle_view=secret", Origin="http://evil.example"), "secret", "403"),
    ],
)
def test_who_is_let_in(request_head, token, status):
    assert judged(request_head, token)[0].partition(" ")[0] == status


def test_a_door_to_a_network_has_a_token():
    with pytest.raises(ValueError, match="needs a token"):
        Door(target=1, host="0.0.0.0")
    assert len({new_token() for _ in range(10)}) == 10 and len(new_token()) >= 20


def test_what_is_posted_is_bounded_and_answered_in_a_line():
    def answer(query, body):
        if body == b"bad":
            raise ValueError("no, for a reason")
        taken.append((query, body))

    taken = []
    door = Door(target=1, answers={"/picture": answer}, largest=10)
    origin = f"http://127.0.0.1:{door.port}"

    def post(path, body, length=None):
        connection = http.client.HTTPConnection("127.0.0.1", door.port, timeout=20)
        connection.request("POST", path, body, {"Origin": origin, **({"Content-Length": length} if length else {})})
        response = connection.getresponse()
        return response.status, response.read().decode().strip()

    assert post("/picture?name=a%20b.png", b"0123456789") == (200, "")
    assert taken == [({"name": "a b.png"}, b"0123456789")]
    assert post("/picture", b"bad") == (400, "no, for a reason")
    assert post("/picture", b"", "11")[0] == 413 and post("/picture", b"", "-1")[0] == 413
    assert post("/elsewhere", b"1")[0] == 404 and len(taken) == 1
    door.close()
