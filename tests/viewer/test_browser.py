"""The live viewer as people use it: Chromium types, uploads, drops, clicks and downloads; what it shows is compared."""

import math
import re
import shutil
import time
import urllib.error
import urllib.request

import av
import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.inference.export import FORMATS
from anystyle.renderers.torch import TorchRenderer
from chromium import SOFTWARE_GL, browser, find_chromium, until
from export.test_formats import LEAST, back
from export_readers import READERS
from viewer.worlds import FOCAL, SIZE, camera, world_in

pytest.importorskip("viser", reason="the extra `viewer` is not installed")

from anystyle.viewer.door import new_token
from anystyle.viewer.flight import pose_of
from anystyle.viewer.serving import Viewer
from anystyle.viewer.session import Wish

CHROMIUM = find_chromium()
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium (apt install chromium)"),
]


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return world_in(tmp_path_factory.mktemp("scene"), short_side=336)


@pytest.fixture(scope="module")
def viewer(world, tmp_path_factory):
    folder = tmp_path_factory.mktemp("kept")
    with Viewer(world.opened, world.render, folder=folder, command=(str(world.path), []), token=new_token()) as viewer:
        yield viewer


def visit(page, viewer):
    """Open the viewer; returns what the program knows of this browser."""
    before = set(viewer.panel._looks)
    page.size(1120, 840)  # of the pictures that are compared: viser would squeeze others
    page.call("Page.navigate", url=viewer.door.url)
    page.wait("document.body && document.body.innerText.includes('Preserve colour')")
    (number,) = until(lambda: set(viewer.panel._looks) - before)
    look = viewer.panel._looks[number]
    look.show_cameras(False)
    look.client.camera.position, look.client.camera.look_at = (0.0, 0.0, 0.0), (0.0, 0.0, 3.0)
    look.client.camera.fov = 2 * math.atan(SIZE[0] / 2 / FOCAL)
    return look


@pytest.fixture(scope="module")
def page(viewer, tmp_path_factory):
    with browser(CHROMIUM, tmp_path_factory.mktemp("browser"), SOFTWARE_GL) as page:
        page.look = visit(page, viewer)
        yield page
        assert not [error for error in page.errors if "favicon" not in error and "413" not in error]


@pytest.fixture(autouse=True)
def begun(viewer, page):
    """Every test begins with the unstyled scene and closed folders."""
    viewer.panel.strength.value, viewer.panel.preserve.value, page.look.split.value = 1.0, False, 0.0
    viewer.panel.ask("")
    until(lambda: viewer.session.shown == Wish() and viewer.panel._shown == Wish())


def press(page, text, kind="button"):
    """Click the element that says so, once it stands still and nothing covers it."""
    mark = f"mark-{time.monotonic_ns()}"
    page.wait(
        f"(() => {{ const e = [...document.querySelectorAll('{kind}')].findLast(e => e.innerText.trim() === '{text}');"
        " if (!e) return false; e.scrollIntoView({block: 'center'}); const r = e.getBoundingClientRect();"
        " const before = e.dataset.at; e.dataset.at = [r.x, r.y, r.height];"
        " const top = document.elementFromPoint(r.x + r.width / 2, r.y + r.height / 2);"
        f" if (before !== e.dataset.at || !e.contains(top)) return false; e.id = '{mark}'; return true; }})()",
        60,
    )
    page.click(f"#{mark}")


def expand(page, folder, inside):
    """Open a folder of the panel."""
    if not page.value(f"document.body.innerText.includes('{inside}')"):
        press(page, folder, "div")
        page.wait(f"document.body.innerText.includes('{inside}')", 60)


def shown(page, text):
    page.wait(f"document.body.innerText.includes('Shown: {text}')")


def paint(page, text):
    page.value(
        "[...document.querySelectorAll('label')].find(e => e.textContent === 'Text')"
        ".closest('div').parentElement.parentElement.querySelector('input').select()"
    )
    page.type(text)
    page.key("Enter", "\r")
    shown(page, text)


def expected(gaussians, pose=None):
    return TorchRenderer()(gaussians, camera(pose)).color[0, 0].permute(1, 2, 0).numpy()


def seen(look):
    """The browser's own picture of the scene, without the panel, over white."""
    rgba = look.client.get_render(*SIZE, transport_format="png") / 255.0
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


def psnr(first, second):
    return float(-10 * np.log10(np.square(first - second).mean()))


def compared(look, target, path):
    """The browser shows the target, the right way round."""
    end = time.monotonic() + 120
    while True:
        picture = seen(look)
        Image.fromarray((picture * 255).astype(np.uint8)).save(path)
        if psnr(picture, target) > 24:
            break
        assert time.monotonic() < end, f"{psnr(picture, target):.1f} dB"
    for wrong in (picture[:, ::-1], picture[::-1]):
        assert np.square(wrong - target).mean() > 3 * np.square(picture - target).mean()
    assert picture.std() > 0.1


def test_who_does_not_know_the_token_is_refused(viewer, page):
    with pytest.raises(urllib.error.HTTPError, match="403"):
        urllib.request.urlopen(viewer.door.url.partition("?")[0])


def test_a_style_that_is_typed_is_seen_and_the_row_goes_back_at_once(viewer, page, tmp_path):
    compared(page.look, expected(viewer.session.controlled.unstyled), tmp_path / "unstyled.png")
    paint(page, "red dots")
    styled = viewer.session.gaussians
    assert not torch.equal(styled.harmonics, viewer.session.controlled.unstyled.harmonics)
    compared(page.look, expected(styled), tmp_path / "styled.png")
    paint(page, "blue waves")
    pictures = page.value("[...document.querySelectorAll('[data-style] img')].map(e => e.naturalWidth)")
    assert len(pictures) >= 3 and min(pictures) > 50
    page.click("[data-style='red dots']")
    shown(page, "red dots")
    assert viewer.session.gaussians is styled
    page.value("document.querySelector('[data-style=\"blue waves\"]').focus()")
    page.key("Enter", "\r")
    shown(page, "blue waves")
    page.picture(tmp_path / "window.png")


def test_progress_is_shown_while_a_style_is_painted(viewer, page, monkeypatch):
    paint_scene = viewer.session.scene

    def half_a_second_later(wish):
        time.sleep(0.5)  # viser sends changes in batches: a bar that goes within one is never there
        return paint_scene(wish)

    monkeypatch.setattr(viewer.session, "scene", half_a_second_later)
    page.value(
        "window.bars = []; new MutationObserver(() => bars.push(!!document.querySelector('[role=progressbar]')))"
        ".observe(document.body, {subtree: true, childList: true}); 0"
    )
    paint(page, "thin lines of gold")
    assert page.value("bars.includes(true)")
    page.wait("!document.querySelector('[role=progressbar]')")


def test_an_uploaded_picture_is_a_style(viewer, page, tmp_path):
    file = tmp_path / "stripes.png"
    Image.fromarray(np.tile(np.uint8([[[250, 200, 0]] * 8 + [[20, 0, 120]] * 8]), (128, 8, 1))).save(file)
    page.call("DOM.enable")
    root = page.call("DOM.getDocument")["root"]["nodeId"]
    button = page.call("DOM.querySelector", nodeId=root, selector="input[type=file]")["nodeId"]
    page.call("DOM.setFileInputFiles", nodeId=button, files=[str(file)])
    shown(page, "stripes")
    assert not torch.equal(viewer.session.gaussians.harmonics, viewer.session.controlled.unstyled.harmonics)


def drop(page, *files):
    data = {"items": [], "files": [str(file) for file in files], "dragOperationsMask": 1}
    page.call("Input.dispatchDragEvent", type="dragEnter", x=300, y=300, data=data)
    while page.value("document.getElementById('anystyle-drop').hidden"):
        page.call("Input.dispatchDragEvent", type="dragOver", x=300, y=300, data=data)
    page.call("Input.dispatchDragEvent", type="drop", x=300, y=300, data=data)
    page.wait("document.getElementById('anystyle-drop').hidden")


def test_a_dropped_picture_is_a_style_and_what_is_none_is_told(viewer, page, tmp_path):
    file = tmp_path / "dunes of sand.jpg"
    Image.effect_mandelbrot((200, 160), (-2, -1, 1, 1), 50).convert("RGB").save(file)
    drop(page, file)
    shown(page, "dunes-of-sand")
    assert viewer.session.picture(viewer.session.shown.style)
    styled = viewer.session.gaussians
    (tmp_path / "notes.txt").write_text("no picture")
    drop(page, tmp_path / "notes.txt")
    page.wait("document.getElementById('anystyle-note').textContent.includes('notes')")
    (tmp_path / "large.png").write_bytes(bytes(33 * 1024 * 1024))
    drop(page, tmp_path / "large.png")
    page.wait("document.getElementById('anystyle-note').textContent.includes('at most 32 are taken')")
    assert viewer.session.gaussians is styled
    page.errors.clear()  # the browser tells of an answer of 400


def test_two_browsers_share_styles_and_each_looks_as_it_likes(viewer, page, tmp_path):
    unstyled = viewer.session.controlled.unstyled
    with browser(CHROMIUM, tmp_path / "second", SOFTWARE_GL) as other:
        look = visit(other, viewer)
        paint(other, "red dots")
        shown(page, "red dots")
        styled = viewer.session.gaussians
        look.unstyled.value = True
        look.refresh()
        compared(look, expected(unstyled), tmp_path / "other.png")
        compared(page.look, expected(styled), tmp_path / "page.png")
        paint(other, "blue waves")  # a new style is not hidden
        assert look.unstyled.value is False
        compared(look, expected(viewer.session.gaussians), tmp_path / "new.png")
    until(lambda: len(viewer.panel._looks) == 1)


def test_before_and_after_part_at_the_line_and_follow_the_camera(viewer, page, tmp_path):
    paint(page, "red dots")
    styled, before = expected(viewer.session.gaussians), expected(viewer.session.controlled.unstyled)
    page.look.split.value = 0.5
    page.look.refresh()
    page.wait("!document.getElementById('anystyle-line').hidden")
    left = page.value("parseFloat(document.getElementById('anystyle-line').style.left) / innerWidth")
    assert abs(left - 0.5) < 0.01
    half = SIZE[1] // 2
    target = np.concatenate([before[:, :half], styled[:, half:]], axis=1)
    # The split is of the window, whose aspect the picture has.
    compared(page.look, target, tmp_path / "split.png")
    turn = torch.eye(4)
    turn[:3, :3] = torch.tensor([[0.98, 0.0, 0.199], [0.0, 1.0, 0.0], [-0.199, 0.0, 0.98]])
    viewer.flight.look_from(page.look.client, turn.double().numpy())
    until(lambda: float(pose_of(page.look.client.camera)[0, 2]) > 0.19)
    pose = pose_of(page.look.client.camera)
    pictures = [expected(scene, pose) for scene in (viewer.session.controlled.unstyled, viewer.session.gaussians)]
    target = np.concatenate([pictures[0][:, :half], pictures[1][:, half:]], axis=1)
    compared(page.look, target, tmp_path / "turned.png")
    viewer.flight.look_from(page.look.client, np.eye(4))
    page.look.split.value = 0.0
    page.look.refresh()
    page.wait("document.getElementById('anystyle-line').hidden")


def test_a_path_of_keyframes_is_previewed_and_rendered(viewer, page, tmp_path):
    expand(page, "Camera path", "Add keyframe")
    viewer.panel.seconds.value = 1
    side = np.eye(4)
    for position in (0.0, 0.4):
        side[0, 3] = position
        viewer.flight.look_from(page.look.client, side)
        until(lambda: np.allclose(pose_of(page.look.client.camera), side, atol=1e-3))
        press(page, "Add keyframe")
    page.wait("document.body.innerText.includes('2 keyframes.')")
    viewer.flight.look_from(page.look.client, np.eye(4))
    press(page, "Preview")
    until(lambda: abs(page.look.client.camera.position[0] - 0.4) < 1e-2)
    press(page, "Render MP4")
    file = until(lambda: next(page.downloads.glob("video*.mp4"), None))
    with av.open(str(file)) as container:
        frames = [frame.to_ndarray(format="rgb24") / 255 for frame in container.decode(video=0)]
    assert len(frames) == 30
    pose = torch.eye(4)
    for frame, position in ((frames[0], 0.0), (frames[-1], 0.4)):
        pose[0, 3] = position
        assert psnr(frame, expected(viewer.session.gaussians, pose)) > 28
    assert psnr(frames[0], frames[-1]) < 25
    press(page, "Clear")
    page.wait("document.body.innerText.includes('No keyframes')")
    viewer.flight.look_from(page.look.client, np.eye(4))


@pytest.mark.parametrize("name", (*FORMATS, "html"))
def test_a_download_holds_what_is_shown(name, viewer, page):
    paint(page, "red dots")
    expand(page, "Save", "Download")
    viewer.panel.format.value = name
    for file in page.downloads.iterdir():
        file.unlink()
    press(page, "Download")
    file = until(lambda: next(page.downloads.glob(f"scene*.{name}"), None))
    if name == "html":
        text = file.read_text(encoding="utf-8")
        titles = re.findall(r'"title":\s*"(.*?)"', text)
        assert {"unstyled", "red dots"} <= set(titles) and "Apache-2.0" in text
        return
    read = back(READERS[name](file), FORMATS[name].up)
    assert psnr(expected(read), expected(viewer.session.gaussians)) > LEAST[name] - 2
    shutil.rmtree(page.downloads)
    page.downloads.mkdir()


def test_a_phone_in_the_dark(viewer, tmp_path):
    with browser(CHROMIUM, tmp_path / "phone", SOFTWARE_GL) as phone:
        phone.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": "dark"}])
        phone.size(390, 844, mobile=True)
        phone.call("Page.navigate", url=viewer.door.url)
        phone.wait("document.querySelector('canvas') && document.body.innerText.includes('anystyle')")
        phone.wait("document.documentElement.dataset.mantineColorScheme === 'dark'")
        phone.wait("[...document.querySelectorAll('[data-style] img')].some(e => e.complete)")
        phone.picture(tmp_path / "phone.png")
        assert phone.value("document.documentElement.scrollWidth <= innerWidth")
