"""The live viewer as people use it: Chromium types, uploads, drops, clicks and downloads; what it shows is compared."""

import math
import re
import time

import av
import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.registry.catalog import catalog
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Gaussians
from tests.support.browser import drop, errors_of, new_page, until, wait
from tests.support.viewer_scene import FOCAL, SIZE, camera, write_scene

pytest.importorskip("viser", reason="the extra `viewer` is not installed")

from anystyle_viewer.client_view import pose_of
from anystyle_viewer.command import open_session
from anystyle_viewer.session import StyleRequest
from anystyle_viewer.viewer import Viewer

pytestmark = pytest.mark.slow
WINDOW = {"width": 1120, "height": 840}
"""The aspect of the pictures that are compared: viser would squeeze others."""


@pytest.fixture(scope="module")
def viewer(tmp_path_factory):
    path, folder = write_scene(tmp_path_factory.mktemp("scene")), tmp_path_factory.mktemp("kept")
    session = open_session(path, ["views.short_side=336"], folder)
    with Viewer(session, folder, (str(path), [])) as viewer:
        yield viewer


def visit(page, viewer):
    """Open the viewer; returns what the program knows of this browser."""
    before = set(viewer._views)
    page.set_viewport_size(WINDOW)
    page.goto(viewer.server.url)
    wait(page, "document.body && document.body.innerText.includes('Preserve colour')")
    (number,) = until(lambda: set(viewer._views) - before)
    view = viewer._views[number]
    assert not view.cameras.value and not any(frustum.visible for frustum in view._frusta)
    view.client.camera.position, view.client.camera.look_at = (0.0, 0.0, 0.0), (0.0, 0.0, 3.0)
    view.client.camera.fov = 2 * math.atan(SIZE[0] / 2 / FOCAL)
    return view


@pytest.fixture(scope="module")
def page(viewer, browser):
    page = new_page(browser, viewport=WINDOW)
    errors = errors_of(page)
    page.view = visit(page, viewer)
    yield page
    # A file that is too large, one that is not a picture, and viser's own: the corners of its quad have no z.
    expected = ("favicon", "413", "400", "computeBoundingSphere")
    assert not [error for error in errors if not any(told in error for told in expected)]


@pytest.fixture(autouse=True)
def begun(viewer, page):
    """Every test begins with the unstyled scene and closed folders."""
    viewer.strength.value, viewer.preserve.value, page.view.split.value = 1.0, False, 0.0
    viewer.request("")
    until(lambda: viewer.session.current == StyleRequest() and viewer._shown == StyleRequest())


def expand(page, folder, inside):
    """Open a folder of the panel."""
    if not page.evaluate(f"document.body.innerText.includes('{inside}')"):
        page.get_by_text(folder, exact=True).click()
        wait(page, f"document.body.innerText.includes('{inside}')", 60)


def shown(page, text):
    wait(page, f"document.body.innerText.includes('Shown: {text}')")


def paint(page, text):
    page.evaluate(
        "[...document.querySelectorAll('label')].find(e => e.textContent === 'Text')"
        ".closest('div').parentElement.parentElement.querySelector('input').select()"
    )
    page.keyboard.insert_text(text)
    page.keyboard.press("Enter")
    shown(page, text)


def expected(gaussians, pose=None):
    return TorchRenderer()(gaussians, camera(pose)).color[0, 0].permute(1, 2, 0).numpy()


def seen(view):
    """The browser's own picture of the scene, without the panel, over white."""
    rgba = view.client.get_render(*SIZE, transport_format="png") / 255.0
    return rgba[..., :3] * rgba[..., 3:] + 1 - rgba[..., 3:]


def psnr(first, second):
    return float(-10 * np.log10(np.square(first - second).mean()))


def compared(view, target, path):
    """The browser shows the target, the right way round."""
    end = time.monotonic() + 120
    while True:
        picture = seen(view)
        Image.fromarray((picture * 255).astype(np.uint8)).save(path)
        if psnr(picture, target) > 24:
            break
        assert time.monotonic() < end, f"{psnr(picture, target):.1f} dB"
    for wrong in (picture[:, ::-1], picture[::-1]):
        assert np.square(wrong - target).mean() > 3 * np.square(picture - target).mean()
    assert picture.std() > 0.1


def test_a_style_that_is_typed_is_seen_and_the_row_goes_back_at_once(viewer, page, tmp_path):
    compared(page.view, expected(viewer.session.restyler.unstyled), tmp_path / "unstyled.png")
    paint(page, "red dots")
    styled = viewer.session.gaussians
    assert not torch.equal(styled.harmonics, viewer.session.restyler.unstyled.harmonics)
    compared(page.view, expected(styled), tmp_path / "styled.png")
    paint(page, "blue waves")
    pictures = page.evaluate("[...document.querySelectorAll('[data-style] img')].map(e => e.naturalWidth)")
    assert len(pictures) >= 3 and min(pictures) > 50
    page.click("[data-style='red dots']")
    shown(page, "red dots")
    assert viewer.session.gaussians is styled
    page.evaluate("document.querySelector('[data-style=\"blue waves\"]').focus()")
    page.keyboard.press("Enter")
    shown(page, "blue waves")
    page.screenshot(path=tmp_path / "window.png")


def test_an_uploaded_picture_is_a_style(viewer, page, tmp_path):
    file = tmp_path / "stripes.png"
    Image.fromarray(np.tile(np.uint8([[[250, 200, 0]] * 8 + [[20, 0, 120]] * 8]), (128, 8, 1))).save(file)
    page.locator("input[type=file]").first.set_input_files(file)
    shown(page, "stripes")
    assert not torch.equal(viewer.session.gaussians.harmonics, viewer.session.restyler.unstyled.harmonics)


def test_a_dropped_picture_is_a_style_and_what_is_none_is_told(viewer, page, tmp_path):
    file = tmp_path / "dunes of sand.jpg"
    Image.effect_mandelbrot((200, 160), (-2, -1, 1, 1), 50).convert("RGB").save(file)
    drop(page, file)
    shown(page, "dunes-of-sand")
    assert viewer.session.image_file(viewer.session.current.style)
    styled = viewer.session.gaussians
    (tmp_path / "notes.txt").write_text("no picture")
    drop(page, tmp_path / "notes.txt")
    wait(page, "document.getElementById('anystyle-note').textContent.includes('notes')")
    (tmp_path / "large.png").write_bytes(bytes(33 * 1024 * 1024))
    drop(page, tmp_path / "large.png")
    wait(page, "document.getElementById('anystyle-note').textContent.includes('at most 32 are taken')")
    assert viewer.session.gaussians is styled


def test_before_and_after_part_at_the_line_and_follow_the_camera(viewer, page, tmp_path):
    paint(page, "red dots")
    styled, before = expected(viewer.session.gaussians), expected(viewer.session.restyler.unstyled)
    page.view.split.value = 0.5
    page.view.refresh()
    wait(page, "!document.getElementById('anystyle-line').hidden")
    left = page.evaluate("parseFloat(document.getElementById('anystyle-line').style.left) / innerWidth")
    assert abs(left - 0.5) < 0.01
    half = SIZE[1] // 2
    target = np.concatenate([before[:, :half], styled[:, half:]], axis=1)
    # The split is of the window, whose aspect the picture has.
    compared(page.view, target, tmp_path / "split.png")
    turn = torch.eye(4)
    turn[:3, :3] = torch.tensor([[0.98, 0.0, 0.199], [0.0, 1.0, 0.0], [-0.199, 0.0, 0.98]])
    viewer.path.look_from(page.view.client, turn.double().numpy())
    until(lambda: float(pose_of(page.view.client.camera)[0, 2]) > 0.19)
    pose = pose_of(page.view.client.camera)
    pictures = [expected(scene, pose) for scene in (viewer.session.restyler.unstyled, viewer.session.gaussians)]
    target = np.concatenate([pictures[0][:, :half], pictures[1][:, half:]], axis=1)
    compared(page.view, target, tmp_path / "turned.png")
    viewer.path.look_from(page.view.client, np.eye(4))
    page.view.split.value = 0.0
    page.view.refresh()
    wait(page, "document.getElementById('anystyle-line').hidden")


def test_a_shift_click_keeps_the_style_near_that_place(viewer, page, tmp_path):
    paint(page, "blue waves")
    styled, unstyled = viewer.session.gaussians, viewer.session.restyler.unstyled
    width, height = page.evaluate("[innerWidth, innerHeight]")
    x, y = width / 2 + height * FOCAL / SIZE[0] * 0.5 / 3, height / 2 - height * FOCAL / SIZE[0] * 0.4 / 3
    viewer.reach.value = 0.2
    page.keyboard.down("Shift")
    page.mouse.click(x, y)
    page.keyboard.up("Shift")
    until(lambda: viewer.session.current.place)
    mask = viewer.session.current.controls.mask
    distance = (unstyled.means[0] - torch.tensor(mask.center)).norm(dim=1)
    inside, outside = distance <= mask.radius - mask.soft / 2, distance >= mask.radius + mask.soft / 2
    assert bool(inside.any()) and bool(outside.any())
    assert torch.equal(viewer.session.gaussians.harmonics[0, inside], styled.harmonics[0, inside])
    assert torch.equal(viewer.session.gaussians.harmonics[0, outside], unstyled.harmonics[0, outside])
    until(lambda: viewer._shown == viewer.session.current)
    compared(page.view, expected(viewer.session.gaussians), tmp_path / "place.png")
    expand(page, "Place", "Everywhere")
    page.get_by_role("button", name="Everywhere", exact=True).click()
    until(lambda: viewer.session.gaussians is styled)


def test_a_path_of_keyframes_is_previewed_and_rendered(viewer, page, tmp_path):
    expand(page, "Camera path", "Add keyframe")
    viewer.seconds.value = 1
    side = np.eye(4)
    for position in (0.0, 0.4):
        side[0, 3] = position
        viewer.path.look_from(page.view.client, side)
        until(lambda: np.allclose(pose_of(page.view.client.camera), side, atol=1e-3))
        page.get_by_role("button", name="Add keyframe", exact=True).click()
    wait(page, "document.body.innerText.includes('2 keyframes.')")
    viewer.path.look_from(page.view.client, np.eye(4))
    page.get_by_role("button", name="Preview", exact=True).click()
    until(lambda: abs(page.view.client.camera.position[0] - 0.4) < 1e-2)
    with page.expect_download() as download:
        page.get_by_role("button", name="Render MP4", exact=True).click()
    with av.open(str(download.value.path())) as container:
        frames = [frame.to_ndarray(format="rgb24") / 255 for frame in container.decode(video=0)]
    assert len(frames) == 30
    pose = torch.eye(4)
    for frame, position in ((frames[0], 0.0), (frames[-1], 0.4)):
        pose[0, 3] = position
        assert psnr(frame, expected(viewer.session.gaussians, pose)) > 28
    assert psnr(frames[0], frames[-1]) < 25
    page.get_by_role("button", name="Clear", exact=True).click()
    wait(page, "document.body.innerText.includes('No keyframes')")
    viewer.path.look_from(page.view.client, np.eye(4))


@pytest.mark.parametrize("name", ["ply", "html"])
def test_a_download_holds_what_is_shown(name, viewer, page, tmp_path):
    paint(page, "red dots")
    expand(page, "Save", "Download")
    assert viewer.format.options == tuple(catalog().names("format"))
    viewer.format.value = name
    with page.expect_download() as download:
        page.get_by_role("button", name="Download", exact=True).click()
    download.value.save_as(file := tmp_path / f"scene.{name}")
    if name == "html":
        text = file.read_text(encoding="utf-8")
        assert {"unstyled", "red dots"} <= set(re.findall(r'"title":\s*"(.*?)"', text)) and "Apache-2.0" in text
    else:
        assert psnr(expected(Gaussians.load(file)), expected(viewer.session.gaussians)) > 60
