"""How the form looks and behaves: sizes, motion, screen readers, light and dark, in a real browser."""

import pytest

from anystyle_study.page import write_page
from tests.support.browser import accessible, phone, wait
from tests.support.study_cases import AB, LOADED, begin, small_study


def show(page, tmp_path, code, **plan):
    """The first set of a study of two, with every picture."""
    study, folder = small_study(tmp_path, sets=2, **plan)
    write_page(study, folder, tmp_path / "form.html")
    begin(page, f"{(tmp_path / 'form.html').as_uri()}#{code}")
    wait(page, LOADED)


@pytest.mark.parametrize(("width", "height", "mobile"), [(1280, 800, False), (390, 844, True)])
@pytest.mark.parametrize("views", [1, 3])
def test_pictures_are_side_by_side_in_one_size_on_every_screen(page, tmp_path, width, height, mobile, views):
    if mobile:
        phone(page, width, height)
    show(page, tmp_path, "P03", frames=3, views=views)
    box = "(i) => { const r = i.getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; }"
    boxes = page.evaluate(f"[...document.querySelectorAll('.method img')].map({box})")
    assert len(boxes) == 2 * views
    for a, b in zip(boxes[:views], boxes[views:], strict=True):
        assert a[1:] == pytest.approx(b[1:], abs=0.6)
        assert a[0] + a[2] <= b[0] and b[0] + b[2] <= width
        assert a[2] > (150 if mobile or views > 1 else 350)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    if not mobile:  # everything at a glance: nobody answers what they have not seen
        assert page.evaluate("document.getElementById('next').getBoundingClientRect().bottom") <= height
    small = boxes[0][2]
    page.click("#enlarge")
    assert page.evaluate(f"({box})(document.querySelector('.method img'))")[2] > 1.1 * small


def test_videos_play_in_step_and_can_be_stopped(page, tmp_path):
    page.emulate_media(reduced_motion="reduce")
    show(page, tmp_path, "P01", frames=8, views=8, show="video", frames_per_second=4)
    times = "[...document.querySelectorAll('video')].map((video) => video.currentTime)"
    assert page.evaluate(f"{times}.length") == 3
    assert page.evaluate(f"{times}.every((time) => time === 0)")  # for who does not bear motion
    page.click("#play")
    wait(page, f"{times}.every((time) => time > 0.5)")
    assert page.evaluate(f"Math.max(...{times}) - Math.min(...{times})") < 0.3
    wait(page, f"{times}.every((time) => time < 0.4)")  # it begins again
    page.click("#play")
    wait(page, "[...document.querySelectorAll('video')].every((video) => video.paused)")


def test_flip_books_turn_together(page, tmp_path):
    show(page, tmp_path, "P01", frames=4, views=4, show="flipbook")
    stacks = "[...document.querySelectorAll('.stack')].filter((stack) => stack.children.length > 1)"
    turned = f"{stacks}.map((stack) => [...stack.children].findIndex((view) => !view.hidden))"
    wait(page, f"{turned}.join() === '2,2,2'")  # by themselves
    page.click("#play")
    page.evaluate(
        "Object.assign(document.querySelector('input[type=range]'), {value: 2}).dispatchEvent(new Event('input'))"
    )
    assert page.evaluate(turned) == [1, 1, 1]


def test_a_screen_reader_is_told_everything(page, tmp_path):
    show(page, tmp_path, "P04", frames=2, views=2)
    told = set(accessible(page))
    assert {
        *(("image", f"{name}, view {view} of 2") for name in ("A", "B", "The original") for view in (1, 2)),
        ("image", "The style to match"),
        ("region", "A"),
        ("progressbar", "Progress"),
        ("group", "Which matches <b>the style</b> better?"),
        ("group", "How easy to recognize is A?"),
        ("group", "How easy to recognize is B?"),
        ("heading", "Compare A and B"),
        ("button", "Next"),
    } <= told
    radios = {name.strip() for role, name in told if role == "radio"}
    assert radios == {f"{score} {label}" for score, label in enumerate(AB, 1)} | {"1 Hard", "2", "3 Easy"}
    assert page.evaluate("document.activeElement.tagName") == "H1"
    page.keyboard.press("Tab")  # the first thing after the heading
    assert page.evaluate("document.activeElement.id") == "enlarge"
