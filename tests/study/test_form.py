"""The form in a real browser, from the first click to the end; and its server, killed between answers."""

import json
import os
import signal
import threading
import time
from http.server import BaseHTTPRequestHandler, HTTPServer

import pytest
from study_cases import small_study

from anystyle.commands.study import main
from anystyle.study.form import render, sequence, write_page
from chromium import browser, find_chromium, until
from study_serving import kept_answers, serving

LOADED = "!!document.querySelector('[data-loaded]')"
SCORES = {"style": 5, "contentA": 3, "contentB": 3}


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"), title="A study of </script> styles")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium: apt-get install chromium, or name one in CHROMIUM")
    with browser(program, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@pytest.fixture(autouse=True)
def _clean(request):
    """Every test finds the window as the first did."""
    yield
    if "page" in request.fixturenames:
        opened = request.getfixturevalue("page")
        opened.size(1280, 800)
        opened.call("Emulation.setEmulatedMedia", features=[])
        opened.call("Network.setBlockedURLs", urls=[])
        opened.errors.clear()


def answer_pages(page, study, participant, first=0, last=None, by="keys"):
    """Answer pages as a person does; returns the scores given."""
    order = study.participant(participant).order
    chosen = {}
    for index, item in list(enumerate(order))[first:last]:
        page.wait(f"document.getElementById('place').textContent === '{index + 1} of {len(order)}' && {LOADED}")
        assert page.value("document.getElementById('next').disabled")
        for step, (field, levels) in enumerate(SCORES.items()):
            score = 1 + (index + 2 * step) % levels
            chosen[item, field.rstrip("AB"), field[-1] if field[-1] in "AB" else ""] = score
            if by == "keys":
                page.key(str(score), str(score))
            else:
                page.click(f"fieldset[data-question={field}] input[value='{score}']")
        if by == "keys":
            page.key("Enter", "\r")
        else:
            page.click("#next")
    return chosen


def start(page, url, clear=True):
    """Open the form as in a browser that has never been there, and begin."""
    page.open(url)
    if clear:
        page.value("localStorage.clear()")
    page.click("#start")


def test_the_static_page_from_first_click_to_saved_answers(page, designed, tmp_path):
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    page.size(1280, 800)
    page.open(f"{(tmp_path / 'form.html').as_uri()}#P02")
    assert page.value("document.querySelector('h1').textContent") == "A study of </script> styles"
    page.value("document.getElementById('code').value = 'nobody'")
    page.click("#start")
    page.wait("document.getElementById('codeerror').textContent.includes('not known')")
    page.value("document.getElementById('code').value = ' p02 '")
    page.click("#start")
    chosen = answer_pages(page, study, "P02", last=2, by="mouse")
    # Resumed in the middle, with what was answered kept; back with the keyboard, and an answer changed.
    page.call("Page.reload")
    page.wait("document.readyState === 'complete' && !!document.getElementById('start')")
    page.value("document.getElementById('code').value = 'P02'")
    page.click("#start")
    page.wait(f"document.getElementById('place').textContent === '3 of 5' && {LOADED}")
    page.key("Backspace")
    page.wait(f"document.getElementById('place').textContent === '2 of 5' && {LOADED}")
    second = study.participant("P02").order[1]
    assert page.value("document.querySelector('fieldset input:checked').value") == str(chosen[second, "style", ""])
    page.click("fieldset[data-question=style] input[value='5']")
    chosen[second, "style", ""] = 5
    page.click("#next")
    chosen |= answer_pages(page, study, "P02", first=2)
    page.wait("!!document.getElementById('end')")
    page.click("#comment")
    page.type('=cmd|"x"\n<i>fine</i>')
    page.click("#end")
    file = until(lambda: next(iter(page.downloads.glob("answers-P02*.json")), None))
    saved = until(lambda: json.loads(file.read_text() or "null"))
    assert (saved["study"], saved["participant"], saved["comment"]) == (study.id, "P02", '=cmd|"x"\n<i>fine</i>')
    assert {(row["item"], row["question"], row["side"]): row["score"] for row in saved["responses"]} == chosen
    assert set(saved["responses"][0]) == {
        *("participant", "item", "question", "side", "score", "seconds", "time", "revision"),
    }
    assert page.errors == []


def test_nothing_is_asked_before_every_picture_is_there(page, designed, tmp_path):
    """Pictures that are blocked keep the set closed; the seconds are counted from when all can be seen."""
    study, folder = designed
    with serving(folder, tmp_path / "answers.sqlite") as (_, url, _):
        page.open(url)
        page.call("Network.setCacheDisabled", cacheDisabled=True)
        page.call("Network.setBlockedURLs", urls=["*/pictures/*"])
        start(page, f"{url}?p=P03")
        page.wait("!!document.getElementById('again')")
        blocked = time.monotonic()
        assert page.value("[...document.querySelectorAll('fieldset')].every((field) => field.disabled)")
        page.key("3", "3")
        page.click("fieldset[data-question=style] input[value='3']")
        assert page.value("document.querySelector('fieldset input:checked')") is None
        assert page.value("document.getElementById('next').disabled")
        page.click("#again")
        page.wait("!!document.getElementById('again')")
        time.sleep(1)
        page.call("Network.setBlockedURLs", urls=[])
        page.click("#again")
        page.wait(LOADED)
        assert page.value("[...document.querySelectorAll('img')].every((i) => i.complete && i.naturalWidth > 0)")
        waited = time.monotonic() - blocked
        page.key("3", "3")
        given = f"Object.values(JSON.parse(localStorage.getItem('study:{study.id}:P03')).answers)"
        assert 0 <= page.value(f"{given}[0].seconds") < waited - 1


def test_a_study_survives_its_server_being_killed_between_any_two_answers(page, designed, tmp_path):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    outbox = f"JSON.parse(localStorage.getItem('study:{study.id}:P01')).outbox"
    with serving(folder, database) as (process, url, port):
        start(page, f"{url}?p=P01")
        chosen = answer_pages(page, study, "P01", last=2)
        page.wait(f"{outbox}.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    # Nobody is stopped, for the next set's pictures are there already; and everybody is told.
    chosen |= answer_pages(page, study, "P01", first=2, last=3)
    page.wait("!document.getElementById('notice').hidden")
    assert page.value(f"{outbox}.length") == 3
    with serving(folder, database, port) as (process, _, _):
        page.wait("document.getElementById('notice').hidden")
        if page.value("!!document.getElementById('again')"):
            page.click("#again")
        chosen |= answer_pages(page, study, "P01", first=3, last=4)
        page.wait(f"{outbox}.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    with serving(folder, database, port) as (_, url, _):
        # After a reload, the answers so far come from the server.
        start(page, f"{url}?p=P01", clear=False)
        page.wait("document.getElementById('place').textContent === '5 of 5'")
        chosen |= answer_pages(page, study, "P01", first=4)
        page.wait("!document.getElementById('end')?.disabled")
        assert kept_answers(database, "P01") == chosen


def test_a_second_browser_is_told_until_the_code_is_released(page, designed, tmp_path, capsys):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (_, url, _):
        start(page, f"{url}?p=P04")
        chosen = answer_pages(page, study, "P04", last=1)
        page.wait(f"JSON.parse(localStorage.getItem('study:{study.id}:P04')).outbox.length === 0")
        start(page, f"{url}?p=P04")  # what the first browser had kept is not here
        page.wait("document.getElementById('codeerror').textContent.includes('another browser')")
        assert kept_answers(database, "P04") == chosen
        main(["form", str(folder), "--database", str(database), "--release", "P04"])
        assert "P04 can go on" in capsys.readouterr().out
        start(page, f"{url}?p=P04")
        page.wait("document.getElementById('place').textContent === '2 of 5'")


def test_recruited_participants_agree_answer_and_go_back_with_a_code(page, tmp_path):
    """The whole way of one of Prolific's participants: id, consent, demographics, sets, code, and back."""
    visited = []

    class Elsewhere(BaseHTTPRequestHandler):
        def do_GET(self):
            visited.append(self.path)
            self.send_response(200)
            self.end_headers()
            self.wfile.write(b"<h1>Back</h1>")

        def log_message(self, format, *args):
            pass

    elsewhere = HTTPServer(("127.0.0.1", 0), Elsewhere)
    threading.Thread(target=elsewhere.serve_forever, daemon=True).start()
    study, folder = small_study(
        tmp_path,
        consent="You may stop at any time.",
        demographics=[
            {"name": "age", "text": "Your age", "choices": ["18 to 30", "older"]},
            {"name": "job", "text": "Your job"},
        ],
        id_parameters=["PROLIFIC_PID", "workerId"],
        completion_url=f"http://127.0.0.1:{elsewhere.server_port}/complete?cc={{code}}",
        completion_code="C0FFEE",
    )
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (_, url, _):
        page.open(f"{url}?workerId=A1&assignmentId=ASSIGNMENT_ID_NOT_AVAILABLE")
        assert page.value("document.getElementById('start').disabled")
        assert "C0FFEE" not in page.value("document.documentElement.outerHTML")
        start(page, f"{url}?PROLIFIC_PID=5f1e&STUDY_ID=1&SESSION_ID=2")
        page.wait("!!document.getElementById('agree')")
        assert page.value("document.getElementById('next').disabled")
        page.click("#agree")
        page.click("#next")
        page.wait("!!document.getElementById('person-age')")
        page.value("document.getElementById('person-age').value = 'older'")
        page.click("#next")
        chosen = answer_pages(page, study, "P01", last=2)
        page.wait(f"JSON.parse(localStorage.getItem('study:{study.id}:5f1e')).outbox.length === 0")
        start(page, f"{url}?PROLIFIC_PID=5f1e", clear=False)  # neither consent nor demographics are asked twice
        chosen |= answer_pages(page, study, "P01", first=2)
        page.wait("!document.getElementById('end')?.disabled")
        page.click("#comment")
        page.type("Fine.")
        page.click("#end")
        page.wait("document.getElementById('completion')?.textContent === 'C0FFEE'")
        page.wait("document.querySelector('h1').textContent === 'Back'")
    elsewhere.shutdown()
    elsewhere.server_close()
    assert visited[0] == "/complete?cc=C0FFEE"
    assert kept_answers(database, "P01") == chosen
    import sqlite3

    connection = sqlite3.connect(database)
    facts = dict(connection.execute("SELECT name, value FROM people WHERE participant = 'P01'").fetchall())
    assert connection.execute("SELECT comment FROM responses WHERE comment IS NOT NULL").fetchall() == [("Fine.",)]
    connection.close()
    assert set(facts) == {"consent", "age"}
    assert facts["age"] == "older"


@pytest.mark.parametrize(("width", "height", "mobile"), [(1280, 800, False), (390, 844, True)])
@pytest.mark.parametrize("views", [1, 3])
def test_pictures_are_side_by_side_in_one_size_on_every_screen(page, tmp_path, width, height, mobile, views):
    study, folder = small_study(tmp_path, frames=3, views=views, sets=2)
    write_page(study, folder, tmp_path / "form.html")
    page.size(width, height, mobile=mobile)
    start(page, f"{(tmp_path / 'form.html').as_uri()}#P03")
    page.wait(LOADED)
    box = "(i) => { const r = i.getBoundingClientRect(); return [r.x, r.y, r.width, r.height]; }"
    boxes = page.value(f"[...document.querySelectorAll('.method img')].map({box})")
    assert len(boxes) == 2 * views
    for a, b in zip(boxes[:views], boxes[views:], strict=True):
        assert a[1:] == pytest.approx(b[1:], abs=0.6)
        assert a[0] + a[2] <= b[0]
        assert b[0] + b[2] <= width
        assert a[2] > (150 if mobile or views > 1 else 350)
    assert page.value("document.documentElement.scrollWidth") <= width
    if not mobile:  # everything at a glance: nobody answers what they have not seen
        assert page.value("document.getElementById('next').getBoundingClientRect().bottom") <= height
    small = boxes[0][2]
    page.click("#enlarge")
    assert page.value(f"({box})(document.querySelector('.method img'))")[2] > 1.1 * small


def test_videos_play_in_step_and_can_be_stopped(page, tmp_path):
    study, folder = small_study(tmp_path, frames=8, views=8, sets=2, show="video", frames_per_second=4)
    write_page(study, folder, tmp_path / "form.html")
    page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-reduced-motion", "value": "reduce"}])
    start(page, f"{(tmp_path / 'form.html').as_uri()}#P01")
    page.wait(LOADED)
    times = "[...document.querySelectorAll('video')].map((video) => video.currentTime)"
    assert page.value(f"{times}.length") == 3
    assert page.value(f"{times}.every((time) => time === 0)")  # for who does not bear motion
    page.click("#play")
    page.wait(f"{times}.every((time) => time > 0.5)")
    assert page.value(f"Math.max(...{times}) - Math.min(...{times})") < 0.3
    page.wait(f"{times}.every((time) => time < 0.4)")  # it begins again
    page.click("#play")
    page.wait("[...document.querySelectorAll('video')].every((video) => video.paused)")


def test_flip_books_turn_together(page, tmp_path):
    study, folder = small_study(tmp_path, frames=4, views=4, sets=2, show="flipbook")
    write_page(study, folder, tmp_path / "form.html")
    start(page, f"{(tmp_path / 'form.html').as_uri()}#P01")
    page.wait(LOADED)
    stacks = "[...document.querySelectorAll('.stack')].filter((stack) => stack.children.length > 1)"
    turned = f"{stacks}.map((stack) => [...stack.children].findIndex((view) => !view.hidden))"
    page.wait(f"{turned}.join() === '2,2,2'")  # by themselves
    page.click("#play")
    page.value(
        "Object.assign(document.querySelector('input[type=range]'), {value: 2}).dispatchEvent(new Event('input'))"
    )
    assert page.value(turned) == [1, 1, 1]


def test_a_screen_reader_is_told_everything(page, tmp_path):
    study, folder = small_study(tmp_path, frames=2, views=2, sets=2)
    write_page(study, folder, tmp_path / "form.html")
    start(page, f"{(tmp_path / 'form.html').as_uri()}#P04")
    page.wait(LOADED)
    accessible = {(one["role"], one["name"]) for one in page.accessible()}
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
    } <= accessible
    radios = {name.strip() for role, name in accessible if role == "radio"}
    assert radios == {
        "1 A is much better",
        "2 A is better",
        "3 No difference",
        "4 B is better",
        "5 B is much better",
    } | {
        *("1 Hard", "2", "3 Easy"),
    }
    assert page.value("document.activeElement.tagName") == "H1"
    page.key("Tab")  # the first thing after the heading
    assert page.value("document.activeElement.id") == "enlarge"


def test_light_and_dark(page, designed, tmp_path):
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    contrast = {}
    for scheme in ("light", "dark"):
        page.call("Emulation.setEmulatedMedia", features=[{"name": "prefers-color-scheme", "value": scheme}])
        start(page, f"{(tmp_path / 'form.html').as_uri()}?{scheme}#P01")
        page.wait(LOADED)
        numbers = "(name, e) => getComputedStyle(e)[name].match(/[0-9.]+/g).slice(0, 3).map(Number)"
        pairs = page.value(
            f"['legend', '.scale span', '.hint'].map((s) => [({numbers})('color', document.querySelector(s)),"
            f" ({numbers})('backgroundColor', document.querySelector(s === '.hint' ? 'html' : 'fieldset'))])"
        )
        contrast[scheme] = pairs
        assert all(_contrast(*pair) > 4.5 for pair in pairs), (scheme, pairs)  # WCAG 2, AA
    assert _luminance(contrast["light"][2][1]) > 0.7
    assert _luminance(contrast["dark"][2][1]) < 0.05


def _luminance(color):
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in (value / 255 for value in color)]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def _contrast(one, other):
    bright, dark = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dark + 0.05)


def test_the_page_tells_nobody_which_method_is_which(designed):
    study, _ = designed
    pictures = dict.fromkeys(study.pictures, "data:,")
    for page in (render(study), render(study, pictures)):
        for word in ("ours", study.ours + '"', "baseline", "degraded", "scene0", "style0", *study.baselines):
            assert word not in page.partition('id="study">')[2].partition("</script>")[0], word
        assert "</script> styles" not in page.partition("<script")[2].partition("</script>")[0]
    first = [
        entry["A"] in {item.ours for item in study.items}
        for one in study.participants
        for entry in sequence(study, one)
    ]
    assert 0 < sum(first) < len(first)
