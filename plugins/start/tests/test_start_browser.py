"""The start page as people use it: Chromium drops, types, waits, looks, downloads; the program is the real one."""

import json
import os
import re
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.examples import resolved
from anystyle.types import Gaussians
from anystyle_start.server import StartServer
from tests.support.browser import accessible, drop, errors_of, new_page, phone, until, wait
from tests.support.program import Program
from tests.support.start_serving import pretended
from tests.support.viewer_scene import write_scene

SMALL = "model=tiny splat.cameras=2 views.short_side=112 video.frames=4"


@pytest.fixture
def server(tmp_path, tmp_path_factory):
    base = tmp_path_factory.getbasetemp()
    program = Program(base.parent if "PYTEST_XDIST_WORKER" in os.environ else base)
    with StartServer(tmp_path / "kept", 0, [str(program.install(tmp_path / "bin") / "anystyle")]) as server:
        yield server


def says(tab, text, seconds=120):
    wait(tab, f"document.body.innerText.includes({text!r})", seconds)


def opened(tab, server):
    tab.goto(server.url)
    wait(tab, "!!document.querySelector('h1') && document.querySelector('h1').textContent !== ''")


def click(tab, text, kind="button"):
    """Click what says so."""
    script = f"[...document.querySelectorAll({kind!r})].find((e) => e.textContent.trim() === {text!r})"
    wait(tab, f"!!{script} && !{script}.disabled")
    tab.evaluate(f"{script}.click()")


def downloaded(tab, file):
    """The file that the button gives, under a name of ours."""
    with tab.expect_download() as download:
        click(tab, "Download")
    assert download.value.suggested_filename.endswith(file.suffix)
    download.value.save_as(file)
    return file


def write(tab, selector, text):
    tab.evaluate(f"document.querySelector({selector!r}).select()")
    tab.keyboard.insert_text(text)


def make(tab, text, more):
    write(tab, ".texts input", text)
    tab.evaluate("document.querySelector('.paintings :checked')?.click()")
    tab.evaluate("document.querySelector('details').open = true")
    write(tab, "#more", more)
    click(tab, "Make the scene")


def test_from_a_dropped_splat_to_a_download(server, browser, page, errors, tmp_path):
    opened(page, server)
    scene = write_scene(tmp_path)
    drop(page, scene)
    says(page, "A splat that is there already")
    assert page.evaluate("document.activeElement.tagName") == "H1"
    make(page, "red dots", f"{SMALL} video.frame=4")
    says(page, "Did you mean 'frames'?")
    assert page.evaluate("document.querySelector('[role=alert]:not([hidden])').textContent").count("\n") == 0
    with new_page(browser) as other:  # another tab that fills a form of its own
        told = errors_of(other)
        opened(other, server)
        click(other, "Take the street that comes along")
        says(other, "12 photographs")
        write(other, ".texts input", "half a thou")
        write(page, "#more", SMALL)
        click(page, "Make the scene")
        wait(page, "!!document.querySelector('.sentence')")
        assert page.evaluate("document.querySelectorAll('.steps li').length") == 3
        page.goto("about:blank")  # closed, and opened again later
        says(other, "Being made: scene")
        assert other.evaluate("document.querySelector('.texts input').value") == "half a thou"
        assert other.evaluate("document.activeElement === document.querySelector('.texts input')")
        assert not told
    opened(page, server)
    page.click(".card:last-child a")
    wait(page, "!!document.querySelector('iframe') && document.querySelector('.styles img').naturalWidth > 50")
    assert page.evaluate("document.querySelector('h1').textContent") == "scene"
    page.evaluate("document.querySelector('[aria-label=Format]').value = 'ply'")
    page.evaluate("document.querySelector('[aria-label=Format]').dispatchEvent(new Event('change'))")
    before, after = Gaussians.load(scene), Gaussians.load(downloaded(page, tmp_path / "scene.ply"))
    assert torch.equal(before.means, after.means) and not torch.equal(before.harmonics, after.harmonics)
    page.select_option("[aria-label=Style]", "unstyled")
    assert torch.equal(Gaussians.load(downloaded(page, tmp_path / "unstyled.ply")).harmonics, before.harmonics)
    page.select_option("[aria-label=Style]", "0")
    for name in ("spz", "zip"):
        page.evaluate(f"document.querySelector('[aria-label=Format]').value = {name!r}")
        file = downloaded(page, tmp_path / f"scene.{name}")
    assert {"scene.ply", "video.mp4", "scene.html", "report.json"} <= set(zipfile.ZipFile(file).namelist())
    command = page.evaluate("document.querySelector('pre').textContent")
    assert re.fullmatch(r"anystyle stylize \S+scene\.ply --text 'red dots' model=tiny .* --out styled-scene", command)
    assert not [error for error in errors if "400 (Bad Request)" not in error]  # of the option that was refused


def test_photographs_without_cameras_get_reasons_and_advice(server, page, tmp_path):
    opened(page, server)
    phone(page, 390, 844)
    for name in ("a", "b", "c"):
        Image.new("RGB", (400, 300), "teal").save(tmp_path / f"{name}.jpg")
    (tmp_path / "broken.jpg").write_text("no photograph")
    drop(page, *sorted(tmp_path.glob("*.jpg")), tmp_path / "broken.jpg")
    wait(page, "document.getElementById('trouble').textContent.includes('broken.jpg')")
    says(page, "3 photographs.")
    assert page.evaluate("document.querySelectorAll('.strip img').length") == 3
    make(page, "red dots", "model=tiny")
    says(page, "The cameras were not found")
    text = page.evaluate("document.querySelector('[data-notice]').innerText")
    assert "There is too little to see in the photographs" in text and "Eight to twenty-four photographs" in text
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    click(page, "use no cameras")
    assert page.evaluate("document.getElementById('more').value") == "reconstruction=feedforward poses=predicted"


def draw_on(tab, server, name):
    """Brush a line and click the sky of a photograph; the mask is black there. Returns its file."""
    tab.click(f"[aria-label='Mark in {name}']")
    wait(
        tab, "document.querySelector('.editor canvas').width > 400 && !document.querySelector('.editor .main').disabled"
    )
    box = tab.locator(".marks").bounding_box()

    def at(x, y):
        return box["x"] + x * box["width"], box["y"] + y * box["height"]

    tab.mouse.move(*at(0.2, 0.9))
    tab.mouse.down()
    tab.mouse.move(*at(0.8, 0.9), steps=4)
    tab.mouse.up()
    tab.mouse.click(*at(0.5, 0.7))
    click(tab, "Undo")  # the dot
    click(tab, "Area", ".editor label")
    tab.mouse.click(*at(0.5, 0.03))  # blue sky
    click(tab, "Done")
    says(tab, "1 of 3 have masks")
    (scene,) = server.application.actions.library.scenes()
    file = server.application.actions.library.masks(scene) / f"{name}.png"
    white = np.asarray(Image.open(file)) > 127
    height, width = white.shape
    with Image.open(resolved(Path("example:street")) / name) as photograph:
        colors = np.asarray(photograph.convert("RGB").resize((width, height))).astype(int)
    assert width == 1024 and abs(width / height / (photograph.width / photograph.height) - 1) < 0.01
    line = white[int(0.9 * height)]
    assert not line[int(0.19 * width) : int(0.81 * width)].any()
    assert line[: int(0.15 * width)].all() and line[int(0.85 * width) :].all()
    assert white[int(0.6 * height) : int(0.84 * height)].all()
    sky = ~white[: height // 2]
    near = np.abs(colors[: height // 2] - colors[int(0.03 * height), width // 2]).max(-1) < 20
    assert (sky & near).sum() > 0.9 * near[:60].sum() and sky.mean() > 0.1
    tab.click(f"[aria-label='Mark in {name}']")  # it can be changed, and closed without a change
    wait(tab, "!document.querySelector('.editor .main').disabled")
    pixels = "[...document.querySelector('.marks').getContext('2d').getImageData(100, 10, 1, 1).data]"
    assert tab.evaluate(pixels)[3] == 255 * (not white[10, 100])
    tab.keyboard.press("Escape")
    assert not tab.evaluate("document.querySelector('.editor').open")
    return file


def test_a_run_is_cancelled_and_a_scene_deleted_when_confirmed(page, tmp_path):
    with StartServer(tmp_path / "kept", 0, pretended(tmp_path)) as server:
        opened(page, server)
        drop(page, *sorted(resolved(Path("example:street")).glob("0[1-3].jpg")))
        says(page, "3 photographs")
        masked = draw_on(page, server, "02.jpg")
        make(page, "wait", "")
        says(page, "Building the scene: step 1 of 4")
        spoken = page.evaluate("document.getElementById('said').textContent")
        assert re.fullmatch(r"Build, \d+ percent done\.", spoken)
        assert {("progressbar", "Progress"), ("button", "Cancel"), ("image", "02.jpg")} <= {*accessible(page)}
        (record,) = server.application.actions.library.scenes().values()
        assert record.job.words[record.job.words.index("--photo-masks") + 1] == str(masked.parent)
        click(page, "Cancel")
        says(page, "Cancelled")
        unnamed = {role for role, name in accessible(page) if not name.strip()}
        assert not unnamed & {"button", "textbox", "slider", "checkbox", "combobox", "radio", "image", "link"}
        for answer, left in (("Cancel", 1), ("Delete", 0)):
            click(page, "Delete", "form > .row button")
            wait(page, "document.getElementById('ask').open")
            click(page, answer, "dialog button")
            until(lambda left=left: len(server.application.actions.library.scenes()) == left)
        says(page, "Photographs in, a scene in any style out")
        assert not list((tmp_path / "kept" / "scenes").iterdir())


@pytest.mark.slow
def test_from_dropped_photographs_to_a_scene_that_is_restyled_live(browser, tmp_path):
    pytest.importorskip("viser", reason="the extra `viewer` is not installed")
    with StartServer(tmp_path / "kept") as server, new_page(browser) as tab:
        errors = errors_of(tab)
        opened(tab, server)
        drop(tab, *sorted(resolved(Path("example:street")).glob("*.jpg")))
        says(tab, "12 photographs")
        picture = Image.new("L", (504, 378), 255)
        picture.paste(0, (0, 0, 504, 100))
        for name in ("01.png", "02.jpg.png"):
            picture.save(tmp_path / name)
        tab.locator("label:has-text('Add masks') input").set_input_files([tmp_path / "01.png", tmp_path / "02.jpg.png"])
        says(tab, "2 of 12 have masks")
        tab.click("input[value='draft']")
        click(tab, "Make the scene")
        wait(tab, "!!document.querySelector('iframe')", 900)
        says(tab, "12 of 12")
        says(tab, "found, and confirmed by a second method")
        tab.screenshot(path=tmp_path / "made.png")
        (report,) = (tmp_path / "kept").glob("scenes/*/runs/1/report.json")
        used = json.loads(report.read_text())["reconstruction"]["masks"]
        assert used["photographs"] == 2 and abs(used["ignored"] - 2 / 12 * 100 / 378) < 0.01
        inside = tab.frame_locator("iframe")
        inside.locator("label input").first.check(timeout=60000)
        click(tab, "Try further styles live")
        wait(tab, "document.querySelector('.stage').classList.contains('live')", 300)
        assert re.fullmatch(
            r"http://127.0.0.1:\d+/#style=unstyled", tab.evaluate("document.querySelector('iframe').src")
        )
        says_inside = tab.frame_locator("iframe").get_by_text("Shown: unstyled")
        says_inside.wait_for(timeout=120000)
        assert not errors
