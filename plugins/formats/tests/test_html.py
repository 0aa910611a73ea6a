"""The page in a real browser: a picture of the scene, the right way round, in the style that is chosen."""

import re
from base64 import b64decode
from dataclasses import replace
from io import BytesIO

import numpy as np
import pytest
import torch
from PIL import Image, ImageOps

from anystyle.geometry.cameras import look_at
from anystyle.geometry.confidence import CELLS, ViewConfidence
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.geometry.transforms import matrix_from_vector
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, StyledScene
from anystyle_formats.html import Html
from anystyle_formats.views import best_view
from tests.support.browser import accessible, errors_of, new_page, phone, wait
from tests.support.export_scene import psnr, scene

SIZE, COUNT = (75, 100), 1500


def cameras():
    poses = torch.eye(4).repeat(1, 2, 1, 1)
    poses[0, 1, :3, :3] = matrix_from_vector(torch.tensor([0.0, 0.25, 0.0]))
    poses[0, 1, :3, 3] = torch.tensor([-0.8, -0.2, 0.1])
    return Cameras(poses, torch.tensor([[85.0, 0, 48], [0, 82.5, 39], [0, 0, 1]]).repeat(1, 2, 1, 1), SIZE)


def blue(gaussians):
    shown = constant_from_rgb(torch.tensor([0.1, 0.2, 0.8])) + 0 * gaussians.harmonics
    return replace(gaussians, harmonics=shown, rotations=gaussians.rotations.flip(1))


def write(path, styles, title="", notes=(), pictures=None):
    scene = StyledScene(tuple(styles), cameras(), ("front", "side"), notes, title, pictures=pictures or {})
    Html().write(scene, path)


def canvas(page, path):
    page.screenshot(path=path)
    return np.asarray(Image.open(path).convert("RGB")).astype(float) / 255


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    path = tmp_path_factory.mktemp("page") / "scene.html"
    styles = [("unstyled", scene(1, COUNT)), ("blue </script>", blue(scene(1, COUNT)))]
    notes = "backbone: Apache-2.0", *(f"line {n} of a long licence, which nobody reads" for n in range(13))
    painting = Image.effect_mandelbrot((1200, 800), (-2, -1, 1, 1), 50)
    write(path, styles, "A scene & <b>more</b>", notes, {"blue </script>": painting})
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
    for style in range(2):
        for view in range(2):
            page.evaluate(f"anystyle.choose({style}).then(() => anystyle.go({view}))")
            shown = canvas(page, tmp_path / f"{style}{view}.png")
            pictures = torch.tensor(np.stack([shown, shown[:, ::-1], shown[::-1]]))
            quality = [psnr(each, expected(style, view)) for each in pictures]
            assert quality[0] > 36 and max(quality[1:]) < 25, (style, view)


def expected(style, view):
    gaussians = (scene(1, COUNT), blue(scene(1, COUNT)))[style]
    return TorchRenderer()(gaussians, cameras().select([view])).color[0, 0].permute(1, 2, 0)


def test_an_antialiased_scene_is_as_faint_as_the_renderer_renders_it(browser, tmp_path):
    thin = replace(scene(1, COUNT), scales=0.2 * scene(1, COUNT).scales).marked(True)
    write(tmp_path / "thin.html", [("thin", thin)])
    page = new_page(browser, viewport={"width": SIZE[1], "height": SIZE[0]}, offline=True, color_scheme="light")
    page.goto((tmp_path / "thin.html").as_uri())
    wait(page, "document.body.dataset.ready")
    page.evaluate("document.body.classList.add('bare'); anystyle.go(0)")
    shown = torch.tensor(canvas(page, tmp_path / "thin.png"))
    seen = [
        TorchRenderer()(thin.marked(mode), cameras().select([0])).color[0, 0].movedim(0, -1) for mode in (False, True)
    ]
    assert psnr(shown, seen[1]) > 36 > psnr(shown, seen[0]) + 6


def test_a_style_has_a_small_picture_as_it_opens_and_its_painting(page):
    opening = page.evaluate("anystyle.scene.opening")
    for style in range(2):
        url = page.evaluate(f"document.querySelectorAll('label canvas')[{style}].toDataURL()")
        shown = Image.open(BytesIO(b64decode(url.partition(",")[2]))).convert("RGB")
        whole = Image.fromarray((expected(style, opening).clamp(0, 1).numpy() * 255).astype(np.uint8))
        pictures = torch.tensor(np.stack([shown, shown.transpose(Image.Transpose.FLIP_LEFT_RIGHT)])) / 255
        target = torch.tensor(np.asarray(ImageOps.fit(whole, shown.size))) / 255
        quality = [psnr(each, target) for each in pictures]
        assert quality[0] > 24 and quality[1] < 18, quality
    pictures = page.evaluate("[...document.querySelectorAll('label img')].map((e) => [e.naturalWidth, e.src.length])")
    assert len(pictures) == 1 and pictures[0][0] == 80 and pictures[0][1] < 6000


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
    page.evaluate("anystyle.choose(0).then(() => anystyle.go(anystyle.scene.opening))")
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
    page.keyboard.press("?")
    assert "come nearer" in page.inner_text("#caption")
    page.keyboard.press("2")  # which is not heard while the keys are read
    page.keyboard.press("Escape")
    shown = page.evaluate("[document.querySelector('dialog').open, document.querySelector(':checked').value]")
    assert shown == [False, "0"]
    page.keyboard.press("f")
    wait(page, "document.fullscreenElement !== null")
    page.keyboard.press("f")
    wait(page, "document.fullscreenElement === null")


@pytest.mark.slow
def test_a_link_shows_the_very_same_picture(page, written, browser, tmp_path):
    page.evaluate("anystyle.choose(1).then(() => anystyle.go(1)).then(() => anystyle.compare(true, 0.3))")
    for key in ("ArrowLeft", "+", "d", "l"):
        page.keyboard.press(key)
    page.evaluate("anystyle.stands()")
    before, address = canvas(page, tmp_path / "before.png"), page.evaluate("location.href")
    assert "#style=2&view=2&camera=" in address and len(address.partition("#")[2]) < 110
    page.evaluate("anystyle.compare(false).then(() => anystyle.choose(0)).then(() => anystyle.go(0))")
    assert np.abs(canvas(page, tmp_path / "elsewhere.png") - before).mean() > 0.01
    size, wrong = {"width": SIZE[1], "height": SIZE[0]}, "#style=9&view=-1&camera=AAAA&compare=1_2"
    with new_page(browser, viewport=size, offline=True, color_scheme="light") as other:
        told = errors_of(other)
        other.goto(f"{written.as_uri()}{wrong}")
        wait(other, "document.body.dataset.ready")
        assert other.evaluate("anystyle.camera.view === anystyle.scene.opening")
        other.evaluate("(address) => { document.body.classList.add('bare'); location = address; }", address)
        wait(other, "document.querySelector(':checked').value === '1'")
        other.evaluate("anystyle.stands()")
        assert told == []
        np.testing.assert_array_equal(canvas(other, tmp_path / "after.png"), before)


def test_it_moves_by_itself_between_where_photographs_looked_from_until_one_takes_over(page):
    page.evaluate("anystyle.choose(0).then(() => anystyle.go(0))")
    page.keyboard.press("p")
    wait(page, "anystyle.camera.position[0] !== anystyle.scene.cameras[0].position[0]")
    page.keyboard.press("ArrowUp")
    assert page.get_attribute("#play", "aria-pressed") == "false"
    page.emulate_media(reduced_motion="reduce")  # no motion, but one photograph after another
    page.evaluate("anystyle.go(0)")
    page.keyboard.press("p")
    places = page.evaluate("[anystyle.camera.view, anystyle.camera.position, anystyle.scene.cameras[1].position]")
    assert places[0] == 1 and places[1] == places[2]
    page.keyboard.press("p")
    page.emulate_media(reduced_motion="no-preference")
    page.keyboard.press("t")
    chosen = "document.querySelector(':checked').value"
    assert page.evaluate(chosen) == "1"
    page.keyboard.press("1")
    assert page.evaluate(chosen) == "0" and page.get_attribute("#cycle", "aria-pressed") == "false"


@pytest.mark.parametrize("degrees", [(-10, 0, 25), (0,), (0, 80), range(-170, 181, 30)])
def test_the_orbit_stays_within_the_angles_of_the_photographs(page, degrees):
    """About a point at distance 2, which a camera that has passed it does not count for."""
    around = """(degrees) => {
        const kept = anystyle.scene.cameras, down = [0, 1, 0];
        const at = (turn) => ({ ...kept[0], position: [2 * -Math.sin(turn), 0, 2 - 2 * Math.cos(turn)],
            axes: [[Math.cos(turn), 0, -Math.sin(turn)], down, [Math.sin(turn), 0, Math.cos(turn)]] });
        anystyle.camera.place = [0, 0, 0, ...down, 0, 0, 1, 2];
        const passed = { ...at(0), position: [0, 0, 3] };
        anystyle.scene.cameras = [...degrees.map((each) => at(each * Math.PI / 180)), passed];
        const angle = anystyle.camera.orbit();
        anystyle.scene.cameras = kept;
        return Array.from({ length: 401 }, (_, time) => angle(time / 10) * 180 / Math.PI);
    }"""
    angles = np.array(page.evaluate(around, list(degrees)))
    assert abs(angles[0]) < 1e-6 and np.abs(np.diff(angles)).max() < 2
    if len(degrees) > 3:
        np.testing.assert_allclose(angles, np.arange(401) * 0.9, atol=1e-6)
    else:
        low, high = min(-0.08, np.radians(min(degrees))), max(0.08, min(0.6, np.radians(max(degrees))))
        np.testing.assert_allclose([angles.min(), angles.max()], np.degrees([low, high]), atol=0.1)


def test_a_phone_in_the_dark_has_all_controls_on_its_screen(page, tmp_path):
    page.evaluate("document.body.classList.remove('bare')")
    page.emulate_media(color_scheme="dark")
    phone(page, 360, 640)
    page.click("#about")
    text = page.inner_text("#caption")
    page.keyboard.press("Escape")
    assert "Apache-2.0" in text and "line 12 of a long licence" in text
    assert page.inner_text("#title") == "A scene & <b>more</b>"
    inside = "(e => { const r = e.getBoundingClientRect(); return r.left >= 0 && r.right <= innerWidth })"
    for element in ("#panel", "#about", "#compare", "#link", "header"):
        assert page.evaluate(f"{inside}(document.querySelector('{element}'))"), element
    page.evaluate("anystyle.stands()")
    assert canvas(page, tmp_path / "phone.png")[5, 90].max() < 0.2  # the ground is dark
    names = {name for role, name in accessible(page) if role in ("radio", "button", "RadioButton")}
    expected = {"unstyled", "blue </script>", "Compare", "Move around", "Full screen", "Keys and about"}
    assert expected <= names and "" not in names
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


def test_it_opens_where_most_is_seen_that_others_see_too():
    """Not close to a part, not from outside past it, and not from behind what hides the rest."""
    generator = torch.Generator().manual_seed(0)
    means = torch.rand(4000, 3, generator=generator) * torch.tensor([4.0, 3.0, 0.1]) + torch.tensor([-2.0, -1.5, 4.0])
    wall = torch.rand(500, 3, generator=generator) * torch.tensor([1.0, 1.0, 0.01]) + torch.tensor([-4.0, -0.5, 3.0])
    means = torch.cat([means, wall])  # which hides nothing from the others
    places = {
        "near": (0, 0, 2.5),
        "past": (3.5, 0, 0),
        "left": (-0.4, 0, 0),
        "whole": (0, 0, 0),
        "right": (0.6, 0, 0),
        "wall": (-3.5, 0, 2),
    }
    poses = torch.eye(4).repeat(6, 1, 1)
    poses[:, :3, 3] = torch.tensor(list(places.values()))
    intrinsics = torch.tensor([[100.0, 0, 50], [0, 100.0, 37.5], [0, 0, 1]]).repeat(1, 6, 1, 1)
    for shift in range(6):
        order = torch.arange(6).roll(shift)
        cameras = Cameras(poses[order][None], intrinsics, (75, 100))
        assert list(places)[order[best_view(means, torch.ones(len(means)), cameras)]] == "whole"


@pytest.mark.slow
def test_what_no_photograph_shows_from_about_there_is_veiled_as_films_fade_it(page, tmp_path):
    seen, confidence = cameras(), ViewConfidence.of(scene(1, COUNT), cameras())
    page.evaluate("document.body.classList.add('bare')")
    page.set_viewport_size({"width": SIZE[1], "height": SIZE[0]})
    page.emulate_media(color_scheme="light")
    veil = """() => anystyle.stands().then(() => { const { width, height } = document.getElementById('veil');
        return [...document.getElementById('veil').getContext('2d').getImageData(0, 0, width, height).data]; })"""
    for view in range(2):
        page.evaluate(f"anystyle.go({view})")
        assert not any(page.evaluate(veil)[3::4])
    place = "(numbers) => { anystyle.camera.place = numbers; return anystyle.stands(); }"
    veiled = []
    for eye in ((0.5, 0.2, 0.1), (1.1, 0.2, 0.5), (3.0, -1.0, 3.0)):  # the scene is at 3.3
        pose = look_at(torch.tensor(eye), torch.tensor([0.0, 0.0, 3.3]))
        page.evaluate("anystyle.choose(0).then(() => anystyle.go(0))")
        page.evaluate(place, [*pose[:3, 3].tolist(), *pose[:3, 1].tolist(), *pose[:3, 2].tolist(), 1.0])
        shown = np.reshape(page.evaluate(veil), (*CELLS, 4))
        expected = confidence(Cameras(pose[None, None], seen.intrinsics[:, :1], SIZE).resized(CELLS))[0]
        assert np.abs(255 * (1 - expected.numpy()) - shown[..., 3]).mean() < 6
        veiled.append(shown[..., 3].mean())
    assert veiled[0] < 50 < veiled[1] < 240 < veiled[2]
    faded = canvas(page, tmp_path / "faded.png")
    page.keyboard.press("v")
    whole = canvas(page, tmp_path / "whole.png")
    page.keyboard.press("v")
    assert faded.min() > whole.min() + 0.2
    np.testing.assert_array_equal(canvas(page, tmp_path / "again.png"), faded)


def test_nothing_is_veiled_of_a_scene_whose_cameras_are_not_those_of_photographs(tmp_path):
    styles = (("unstyled", scene(1, 50)),)
    named = StyledScene(styles, cameras(), ("front", "side"), photographed=False)
    for name, given in (("chosen", named), ("none", StyledScene(styles))):
        Html().write(given, tmp_path / name)
        assert '"fade": null' in (tmp_path / name).read_text(encoding="utf-8")
