"""The live viewer as people use it, its door, and what it remembers."""

import threading
import time
import urllib.error
import urllib.request
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from PIL import Image

import anystyle
from anystyle.commands.view import rendered
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.inference.controls import with_colors_of
from anystyle.inference.saved import SavedScene
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians
from anystyle.viewer.door import Door, judged, new_token
from anystyle.viewer.scenes import of_saved
from anystyle.viewer.session import Session, Wish
from chromium import SOFTWARE_GL, browser, find_chromium, until

SIZE = (336, 448)


def scene(count=2500):
    generator = torch.Generator().manual_seed(0)
    right = (torch.arange(count) % 2 == 0)[:, None]
    means = torch.randn(count, 3, generator=generator) * torch.tensor([0.35, 0.35, 0.15])
    means += torch.where(right, torch.tensor([0.5, -0.4, 3.0]), torch.tensor([-0.5, 0.3, 3.2]))
    rgb = torch.where(right, torch.tensor([0.85, 0.2, 0.1]), torch.tensor([0.1, 0.6, 0.25]))
    return Gaussians(
        means=means[None],
        rotations=torch.randn(1, count, 4, generator=generator),
        scales=0.02 + 0.05 * torch.rand(1, count, 3, generator=generator),
        opacities=0.5 + 0.49 * torch.rand(1, count, generator=generator),
        harmonics=constant_from_rgb(rgb)[None, :, None],
    )


def cameras():
    intrinsics = torch.tensor([[370.0, 0, 224], [0, 370.0, 168], [0, 0, 1]])
    return Cameras(torch.eye(4)[None, None], intrinsics[None, None], SIZE)


@pytest.fixture(scope="module")
def stylizer():
    return anystyle.load()


@pytest.fixture(scope="module")
def opened(stylizer):
    saved = SavedScene((("unstyled", scene()),), cameras(), ("front",), ())
    return of_saved(saved, stylizer)


def settled(session, wish):
    session.ask(wish)
    return until(lambda: session.shown == wish and session.gaussians)


def test_a_saved_scene_takes_new_styles_and_going_back_costs_nothing(opened):
    session = Session(opened.unstyled, controlled=opened.controlled)
    red, swirls = Wish("red dots"), Wish("thick blue swirls")
    first = settled(session, red)
    assert torch.equal(first.means, opened.unstyled.means) and not torch.equal(
        first.harmonics, opened.unstyled.harmonics
    )
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
    session.close()


def test_the_newest_wish_wins_and_those_between_are_never_begun(opened):
    session = Session(opened.unstyled)
    begun, go = [], threading.Event()

    def slow(wish):
        begun.append(wish.style)
        go.wait(60)
        return opened.unstyled

    session.scene = slow
    session.ask(Wish("first"))
    until(lambda: begun)
    for style in ("second", "third", "fourth"):
        session.ask(Wish(style))
    go.set()
    until(lambda: session.shown.style == "fourth")
    assert begun == ["first", "fourth"]
    session.close()


def test_what_cannot_be_painted_is_said_and_changes_nothing(opened):
    session = Session(opened.unstyled)
    session.ask(Wish("anything"))
    until(lambda: "no model" in session.status)
    assert session.shown == Wish() and session.gaussians is opened.unstyled
    session.close()


def test_closing_loses_nothing_and_a_damaged_memory_is_no_obstacle(opened, tmp_path):
    file = tmp_path / "session.json"
    session = Session(opened.unstyled, controlled=opened.controlled, file=file)
    settled(session, Wish("red dots"))
    settled(session, Wish("thick blue swirls", strength=0.5))
    session.close()
    again = Session(opened.unstyled, controlled=opened.controlled, file=file)
    until(lambda: again.shown == Wish("thick blue swirls", strength=0.5))
    assert again.recent == ["thick blue swirls", "red dots"]
    again.close()
    for damage in ("[", '{"recent": 3}', "null"):
        file.write_text(damage)
        blank = Session(opened.unstyled, file=file)
        assert blank.recent == [] and blank.shown == Wish()
        blank.close()


def test_the_command_line_says_what_is_shown(tmp_path):
    Image.new("RGB", (8, 8)).save(tmp_path / "my picture.png")
    wish = Wish("it's", str(tmp_path / "my picture.png"), 0.25, 0.5, 1.0)
    assert wish.command("photos/") == (
        "anystyle stylize photos/ --text 'it'\"'\"'s' --image "
        f"'{tmp_path}/my picture.png' --mix 0.25 --strength 0.5 --preserve-color 1"
    )
    assert "--strength 0" in Wish().command("x") and Wish("a").command("x") == "anystyle stylize x --text a"


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
        (b"POST / HTTP/1.1\r\nHost: localhost\r\n\r\n", None, "405"),
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


CHROMIUM = find_chromium()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt install chromium)")
def test_a_browser_types_a_style_and_sees_it_the_right_way_round(opened, stylizer, tmp_path):
    viser = pytest.importorskip("viser", reason="the extra `viewer` is not installed")
    from anystyle.viewer.flight import Flight
    from anystyle.viewer.panel import Panel

    session = Session(opened.unstyled, controlled=opened.controlled, file=tmp_path / "session.json")
    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    flight = Flight(opened.cameras, opened.unstyled, partial(rendered, stylizer))
    panel = Panel(server, opened, session, inputs="photos", uploads=tmp_path / "uploads", flight=flight)
    token = new_token()
    door = Door(target=server.get_port(), token=token)
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(door.url.partition("?")[0])
    try:
        with browser(CHROMIUM, tmp_path / "browser", SOFTWARE_GL) as page:
            page.size(SIZE[1], SIZE[0])
            page.call("Page.navigate", url=door.url)
            page.wait("document.body && document.body.innerText.includes('Preserve colour')")
            client = until(lambda: next(iter(server.get_clients().values()), None))
            panel._show_cameras(False)
            client.camera.position, client.camera.look_at = (0.0, 0.0, 0.0), (0.0, 0.0, 3.0)
            client.camera.fov = flight.field_of_view
            compared(page, opened.unstyled, client, tmp_path / "unstyled.png")
            page.value(
                "[...document.querySelectorAll('label')].find(e => e.textContent === 'Text')"
                ".closest('div').parentElement.parentElement.querySelector('input').focus()"
            )
            page.type("red dots")
            page.key("Enter", "\r")
            page.wait("document.body.innerText.includes('Shown: red dots')")
            assert session.shown.style == "red dots" and not torch.equal(
                session.gaussians.harmonics, opened.unstyled.harmonics
            )
            compared(page, session.gaussians, client, tmp_path / "styled.png")
            assert not [error for error in page.errors if "favicon" not in error]
            written = tmp_path / "video.mp4"
            flight.add(client.camera)
            flight.write(session.gaussians, written, 1)
            assert written.stat().st_size > 1000
    finally:
        door.close()
        session.close()
        server.stop()


def compared(page, gaussians, client, path):
    """The page's own picture of the scene, without its panel, against the renderer's from the same camera."""
    expected = TorchRenderer()(gaussians, cameras()).color[0, 0].permute(1, 2, 0).numpy()
    end = time.monotonic() + 60
    while True:
        rgba = client.get_render(*SIZE, transport_format="png") / 255.0
        shown = rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]  # over white
        Image.fromarray((shown * 255).astype(np.uint8)).save(path)
        error = np.square(shown - expected).mean()
        if -10 * np.log10(error) > 22:
            break
        assert time.monotonic() < end, f"{-10 * np.log10(error):.1f} dB"
        time.sleep(0.5)
    for wrong in (shown[:, ::-1], shown[::-1]):
        assert np.square(wrong - expected).mean() > 3 * error
