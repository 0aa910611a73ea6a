"""The app as people use it: Chromium adds files, types, waits, looks and downloads; the program is the real one."""

import http.client
import signal
import subprocess
import sys
import zipfile
from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.types import Gaussians
from tests.support.browser import accessible, new_page, until, wait
from tests.support.viewer_scene import write_scene

pytest.importorskip("gradio", reason="the extra `app` is not installed")

SMALL = ("model=tiny", "splat.cameras=2", "views.short_side=112", "video.frames=4")


@pytest.fixture(scope="module")
def app(tmp_path_factory):
    """The address of the program; it ends without a traceback when it is interrupted."""
    command = [sys.executable, "-m", "anystyle", "app", "--out", str(tmp_path_factory.mktemp("app")), *SMALL]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
        assert program.stdout is not None
        yield program.stdout.readline().split()[0]
        program.send_signal(signal.SIGINT)
        said = program.communicate(timeout=60)[1]
        assert program.returncode == 130
        assert said.endswith("anystyle: interrupted\n") and "Traceback" not in said


def asked(address, host="127.0.0.1", path="/"):
    connection = http.client.HTTPConnection(address.split("/")[2], timeout=60)
    connection.request("GET", path, headers={"Host": host})
    status = connection.getresponse().status
    connection.close()
    return status


def is_red(picture):
    """Whether there is red in the middle of a screenshot."""
    image = Image.open(BytesIO(picture)).convert("RGB")
    red, green, _ = np.asarray(image)[image.height // 2, image.width // 2].astype(int)
    return red > green + 50


def test_only_this_machine_may_ask(app):
    assert app.startswith("http://127.0.0.1:")
    assert [asked(app, host) for host in ("127.0.0.1", "localhost", "evil.example")] == [200, 200, 400]


@pytest.mark.parametrize(
    "path", ["/made/../app", "/made/..%2F..%2Fetc/passwd", "/made/x/scene.ply", "/made/x/report.json"]
)
def test_nothing_but_scenes_is_served(app, path):
    assert asked(app, path=path) == 404


def test_from_a_splat_to_the_last_download(app, browser, page, errors, tmp_path):
    addresses, splat = [], write_scene(tmp_path)
    page.on("request", lambda request: addresses.append(request.url))
    page.goto(app)
    make = page.get_by_role("button", name="Make the scene")
    make.click()
    page.get_by_role("alert").wait_for()
    assert page.get_by_role("alert").inner_text() == (
        "no photographs are given; add some, or a video or a splat, or choose the example"
    )
    page.locator("input[type=file]").first.set_input_files(splat)
    page.get_by_label("What it looks like").fill("red <dots>")
    wait(page, "document.body.innerText.replace(/\\s/g, '').includes('scene.ply')")  # name and suffix are apart
    make.click()
    page.locator("iframe").wait_for()
    assert page.get_by_role("alert").count() == 0
    until(lambda: is_red(page.locator("iframe").screenshot()))
    names = {}
    for link in page.locator(".files a[download]").all():
        with page.expect_download() as download:
            link.click()
        name = download.value.suggested_filename
        names[name] = tmp_path / name
        download.value.save_as(names[name])
    assert list(names) == [f"scene_red-dots.{kind}" for kind in ("html", "ply", "mp4", "zip")]
    before, after = Gaussians.load(splat), Gaussians.load(names["scene_red-dots.ply"])
    assert torch.equal(before.means, after.means) and not torch.equal(before.harmonics, after.harmonics)
    assert "scene_red-dots/report.json" in zipfile.ZipFile(names["scene_red-dots.zip"]).namelist()
    page.get_by_label("Brush strokes").check()  # add Gaussians, and know no strength
    page.get_by_label("number input for Strength").wait_for(state="hidden")
    page.get_by_label("Painter", exact=True).check()
    page.get_by_label("number input for Strength").wait_for()
    page.get_by_label("Painting", exact=True).check()
    page.get_by_role("button", name="Thumbnail 2 of 7").click()
    page.get_by_text("The Great Wave off Kanagawa", exact=True).first.wait_for()
    make.click()
    page.locator("iframe[title='scene_the-great-wave-off-kanagawa']").wait_for()
    with new_page(browser) as other:  # somebody who comes later
        other.goto(app)
        other.get_by_label("Made before").click()
        other.get_by_role("option", name="scene_red-dots").click()
        other.locator("iframe[title='scene_red-dots']").wait_for()
    assert {"Scene", "Style", "Strength", "Made with"} <= {name for _, name in accessible(page)}
    assert [address for address in addresses if not address.startswith((app, "data:", "blob:"))] == []
    assert not errors
