"""The page in a real browser: a picture of the scene, the right way round, in the style that is chosen."""

import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from PIL import Image

from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.geometry.transforms import matrix_from_vector
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, StyledScene
from anystyle_formats.html import Html
from tests.support.browser import accessible, errors_of, new_page, phone, wait
from tests.support.export_scene import psnr, scene

SIZE, COUNT = (75, 100), 1500


def cameras():
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, :3, :3] = matrix_from_vector(torch.tensor([0.0, 0.25, 0.0]))
    poses[0, 1, :3, 3] = torch.tensor([-0.8, -0.2, 0.1])
    intrinsics = torch.tensor([[85.0, 0, 48], [0, 82.5, 39], [0, 0, 1]]).repeat(1, 2, 1, 1)
    return Cameras(poses, intrinsics, SIZE)


def blue(gaussians):
    shown = constant_from_rgb(torch.tensor([0.1, 0.2, 0.8])) + 0 * gaussians.harmonics
    return replace(gaussians, harmonics=shown, rotations=gaussians.rotations.flip(1))


def write(path, styles, title="", notes=()):
    Html().write(StyledScene(tuple(styles), cameras(), ("front", "side"), notes, title), path)


def canvas(page, path):
    page.screenshot(path=path)
    return np.asarray(Image.open(path).convert("RGB")).astype(float) / 255


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "scene.html"
    styles = [("unstyled", scene(1, COUNT)), ("blue </script>", blue(scene(1, COUNT)))]
    notes = "backbone: Apache-2.0", *(f"line {n} of a long licence, which nobody reads" for n in range(13))
    write(path, styles, "A scene & <b>more</b>", notes)
    return path


@pytest.fixture(scope="module")
def page(written, browser):
    page = new_page(browser, viewport={"width": SIZE[1], "height": SIZE[0]}, offline=True, color_scheme="light")
    errors = errors_of(page)
    page.goto(written.as_uri())
    wait(page, "document.body.dataset.ready")
    assert page.evaluate("document.body.dataset.ready") == "true", page.inner_text("body")
    page.evaluate("document.body.classList.add('bare')")
    yield page
    assert errors == []


def test_every_style_and_camera_shows_what_the_renderer_renders(page, tmp_path):
    for style, gaussians in enumerate((scene(1, COUNT), blue(scene(1, COUNT)))):
        for view in range(2):
            page.evaluate(f"anystyle.choose({style}).then(() => anystyle.go({view}))")
            shown = canvas(page, tmp_path / f"{style}{view}.png")
            expected = TorchRenderer()(gaussians, cameras().select([view])).color[0, 0].permute(1, 2, 0)
            pictures = torch.tensor(np.stack([shown, shown[:, ::-1], shown[::-1]]))
            quality = [psnr(each, expected) for each in pictures]
            assert quality[0] > 36 and max(quality[1:]) < 25, (style, view)


def test_two_styles_meet_where_the_divider_is(page, tmp_path):
    page.evaluate("anystyle.choose(1).then(() => anystyle.go(0))")
    whole = canvas(page, tmp_path / "whole.png")
    page.evaluate("anystyle.compare(true, 0.5)")
    page.evaluate("document.getElementById('divider').hidden = true")
    split = canvas(page, tmp_path / "split.png")
    np.testing.assert_array_equal(split[:, 50:], whole[:, 50:])
    page.evaluate("anystyle.compare(false).then(() => anystyle.choose(0))")
    np.testing.assert_array_equal(split[:, :50], canvas(page, tmp_path / "other.png")[:, :50])


def test_keys_choose_turn_and_go_back(page, tmp_path):
    page.evaluate("anystyle.choose(0).then(() => anystyle.go(0))")
    before = canvas(page, tmp_path / "before.png")
    page.evaluate("document.getElementById('canvas').focus()")
    page.keyboard.press("2")
    assert page.evaluate("document.querySelector('input[value=\"1\"]').checked")
    page.keyboard.press("1")
    page.keyboard.press("ArrowLeft")
    page.evaluate("anystyle.stands()")
    assert np.abs(canvas(page, tmp_path / "turned.png") - before).mean() > 0.01
    page.keyboard.press("r")
    page.evaluate("anystyle.stands()")
    np.testing.assert_array_equal(canvas(page, tmp_path / "back.png"), before)


def test_a_phone_in_the_dark_has_all_controls_on_its_screen(page, tmp_path):
    page.evaluate("document.body.classList.remove('bare')")
    page.emulate_media(color_scheme="dark")
    phone(page, 360, 640)
    page.click("#about")
    text = page.inner_text("#caption")
    assert "Apache-2.0" in text and "line 12 of a long licence" in text
    assert page.inner_text("#title") == "A scene & <b>more</b>"
    inside = "(e => { const r = e.getBoundingClientRect(); return r.left >= 0 && r.right <= innerWidth })"
    for element in ("#panel", "#about", "#compare", "header"):
        assert page.evaluate(f"{inside}(document.querySelector('{element}'))"), element
    page.evaluate("anystyle.stands()")
    shown = canvas(page, tmp_path / "phone.png")
    assert shown[5, 90].max() < 0.2  # the ground is dark
    names = {name for role, name in accessible(page) if role in ("radio", "button", "RadioButton")}
    assert {"unstyled", "blue </script>", "Compare", "About"} <= names
    page.check("input[value='0']")  # which long notes do not push away


def test_a_page_asks_nothing_of_the_network(written):
    text = written.read_text(encoding="utf-8")
    assert not re.search(r"https?://", text) and not re.search(r"(src|href)=", text.replace("script-src", ""))
    assert "default-src 'none'" in text and text.count("</script>") == 3


def test_five_styles_take_at_most_eighty_bytes_per_gaussian(tmp_path):
    generator, whole = torch.Generator().manual_seed(0), scene(1, 20_000)
    colors = torch.randn(5, 1, 20_000, 1, 3, generator=generator)
    write(tmp_path / "scene.html", [(f"style {n}", replace(whole, harmonics=each)) for n, each in enumerate(colors)])
    assert (tmp_path / "scene.html").stat().st_size <= 80 * 20_000


def test_styles_of_other_scenes_are_refused(tmp_path):
    other = replace(scene(1, COUNT), means=scene(1, COUNT).means + 1)
    for wrong in (other, scene(1, 30)):
        with pytest.raises(ValueError, match="one page, one scene"):
            write(tmp_path / "scene.html", [("one", scene(1, COUNT)), ("other", wrong)])
    assert list(tmp_path.iterdir()) == []
