"""The form in a real browser, from the first click to exported answers; and its server, killed between answers."""

import csv
import http.client
import io
import json
import os
import re
import signal
import subprocess
import sys
import threading
import urllib.error
import urllib.request
from contextlib import closing, contextmanager
from pathlib import Path

import pytest
from study_cases import small_study

from anystyle.study.analysis import Settings, analyze
from anystyle.study.checks import Rules, check
from anystyle.study.contract import Scale
from anystyle.study.form import page_data, static_page, write_page
from anystyle.study.plan import Question
from anystyle.study.reading import read_responses
from anystyle.study.store import Store
from anystyle.study.tests.one_sample_t import OneSampleT
from chromium import browser, find_chromium, until

QUESTIONS = (Question("style", "Which matches <b>the style</b> better?"), Question("overall", "Which do you prefer?"))
SESSION = "0123456789abcdef"
PATIENCE = 120
"""Seconds after which a process hangs; a busy machine takes long for an answer."""


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"), questions=QUESTIONS, title="A study of </script> styles")


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    program = find_chromium()
    if program is None:
        pytest.skip("no Chromium: apt-get install chromium, or name one in CHROMIUM")
    with browser(program, tmp_path_factory.mktemp("browser")) as opened:
        yield opened


@contextmanager
def serving(folder: Path, database: Path, port: int = 0):
    """``anystyle study form --serve`` in a process of its own; the address it told."""
    command = [sys.executable, "-m", "anystyle", "study", "form", str(folder), "--serve"]
    command += ["--port", str(port), "--database", str(database)]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A suite in the background ignores interrupts, and so would what it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        found = re.search(r"http://[\d.]+:(\d+)/", line)
        assert found, line + (process.stderr.read() if process.stderr else "")
        yield process, found[0], int(found[1])
    finally:
        process.kill()
        process.communicate()


def post(url: str, message: object, kind: str = "application/json") -> tuple[int, dict]:
    body = message if isinstance(message, bytes) else json.dumps(message).encode()
    request = urllib.request.Request(url + "answers", body, {"Content-Type": kind})
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as reply:
            return reply.status, json.loads(reply.read())
    except urllib.error.HTTPError as error:
        with error:
            return error.code, json.loads(error.read())


def answer(study, participant, item, question="style", score=2, **changes):
    return {
        "study": study.id,
        "participant": participant,
        "session": SESSION,
        "item": item,
        "question": question,
        "score": score,
        "seconds": 1.5,
        "time": "2026-01-01T00:00:00Z",
        "revision": 1,
        **changes,
    }


def expected_answers(study, participant, chosen):
    """What the analysis has to see of a participant's scores: the deviation, positions undone."""
    one = next(one for one in study.participants if one.id == participant)
    return {
        (item, question): (score - 3) * (1 if item in one.ours_is_a else -1)
        for (item, question), score in chosen.items()
        if not item.startswith("check")
    }


def analysed(paths, participant):
    _, by_question = check(read_responses(paths), scale=Scale(), rules=Rules())
    return {
        (one.item_names[item], one.question): deviation
        for one in by_question
        for item, person, deviation in zip(one.items, one.participants, one.deviations.tolist(), strict=True)
        if one.participant_names[person] == participant
    }


def answer_pages(page, study, participant, first=0, last=None, by="keys"):
    """Answer pages as a person does; returns the scores given."""
    one = next(one for one in study.participants if one.id == participant)
    chosen = {}
    for place, item in list(enumerate(one.order))[first:last]:
        page.wait(f"document.getElementById('place').textContent === '{place + 1} of {len(one.order)}'")
        assert page.value("document.getElementById('next').disabled")
        for step, question in enumerate(study.plan.questions):
            score = study.checks[0].expected if item.startswith("check") else 1 + (place + 2 * step) % 5
            chosen[item, question.name] = score
            if by == "keys":
                page.key(str(score), str(score))
            else:
                page.click(f"fieldset[data-question={question.name}] input[value='{score}']")
        if by == "keys":
            page.key("Enter", "\r")
        else:
            page.click("#next")
    return chosen


def test_the_static_page_from_first_click_to_exported_answers(page, designed, tmp_path):
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
    assert page.value("document.getElementById('code').value") == "P02"
    page.click("#start")
    page.wait("document.getElementById('place').textContent === '3 of 5'")
    page.key("Backspace")
    page.wait("document.getElementById('place').textContent === '2 of 5'")
    second = next(one for one in study.participants if one.id == "P02").order[1]
    assert page.value("document.querySelector('fieldset input:checked').value") == str(chosen[second, "style"])
    if not second.startswith("check"):
        page.click("fieldset[data-question=style] input[value='5']")
        chosen[second, "style"] = 5
    page.click("#next")
    chosen |= answer_pages(page, study, "P02", first=2)
    page.wait("!!document.getElementById('csv')")
    page.click("#comment")
    page.type('=cmd|"x"\n<i>fine</i>')
    page.click("#csv")
    file = until(lambda: next(iter(page.downloads.glob("answers-P02*.csv")), None))
    text = until(lambda: file.read_bytes().decode())
    rows = list(csv.DictReader(io.StringIO(text, newline="")))
    assert {(row["item"], row["question"]): int(row["score"]) for row in rows} == chosen
    assert rows[0]["comment"] == '\'=cmd|"x"\n<i>fine</i>'  # no spreadsheet takes it for a formula
    assert analysed([file], "P02") == expected_answers(study, "P02", chosen)
    page.click("#json")
    exported = until(lambda: next(iter(page.downloads.glob("answers-P02*.json")), None))
    assert analysed([exported], "P02") == expected_answers(study, "P02", chosen)
    assert page.errors == []


def test_pictures_are_side_by_side_in_one_size_on_every_screen(page, designed, tmp_path):
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    for width, height, mobile in ((1280, 800, False), (390, 844, True)):
        page.size(width, height, mobile=mobile)
        page.open(f"{(tmp_path / 'form.html').as_uri()}?{width}#P03")
        page.click("#start")
        page.wait("document.querySelectorAll('#pair img').length === 2 || !!document.querySelector('.words h1')")
        if page.value("!document.getElementById('pair')"):  # an attention check comes first
            answer_pages(page, study, "P03", last=1)
        page.wait("[...document.images].every((i) => i.complete && i.naturalWidth > 0)")
        boxes = page.value(
            "[...document.querySelectorAll('#pair img')].map((i) => { const r = i.getBoundingClientRect();"
            " return [r.x, r.y, r.width, r.height]; })"
        )
        assert boxes[0][1:] == pytest.approx(boxes[1][1:], abs=0.1)
        assert boxes[0][0] + boxes[0][2] <= boxes[1][0]
        assert boxes[1][0] + boxes[1][2] <= width
        assert boxes[0][2] > (150 if mobile else 350)
        assert page.value("document.documentElement.scrollWidth") <= width
    page.size(1280, 800)


def test_a_screen_reader_is_told_everything(page, designed, tmp_path):
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    page.open(f"{(tmp_path / 'form.html').as_uri()}?reader#P04")
    page.click("#start")
    page.wait("!!document.querySelector('fieldset')")
    if page.value("!document.getElementById('pair')"):
        answer_pages(page, study, "P04", last=1)
        page.wait("!!document.getElementById('pair')")
    told = {(one["role"], one["name"]) for one in page.accessible()}
    assert {
        ("image", "Picture A"),
        ("image", "Picture B"),
        ("image", "The photograph"),
        ("image", "The style to match"),
        ("progressbar", "Progress"),
        ("group", "Which matches <b>the style</b> better?"),
        ("heading", "Compare A and B"),
        ("button", "Next"),
    } <= told
    radios = {name for role, name in told if role == "radio"}
    assert radios == set(study.plan.labels)
    assert page.value("document.activeElement.tagName") == "H1"


def test_the_page_tells_nobody_which_method_is_which(designed):
    study, folder = designed
    page = static_page(study, folder)
    for word in ("ours_is_a", study.ours + '"', "baseline", "scene0", "style0", *study.baselines):
        assert word not in page.replace('"ours_is"', ""), word
    content = page_data(study, server=False)
    firsts = [item["pair"][0] == one.ours for item, one in zip(content["items"].values(), study.items, strict=True)]
    assert content["items"][study.items[0].id]["pair"] == sorted(content["items"][study.items[0].id]["pair"])
    assert len(firsts) == 4
    assert "</script> styles" not in page.partition("<script")[2].partition("</script>")[0]


def test_a_study_survives_its_server_being_killed_between_any_two_answers(page, designed, tmp_path):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (process, url, port):
        page.open(f"{url}?p=P01")
        page.click("#start")
        chosen = answer_pages(page, study, "P01", last=2)
        page.wait("JSON.parse(localStorage.getItem('study:" + study.id + ":P01')).outbox.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    chosen |= answer_pages(page, study, "P01", first=2, last=3)  # nobody is stopped, and everybody is told
    page.wait("!document.getElementById('notice').hidden")
    kept = json.loads(page.value(f"localStorage.getItem('study:{study.id}:P01')"))["outbox"]
    assert len(kept) == 2
    with serving(folder, database, port) as (process, _, _):
        page.wait("document.getElementById('notice').hidden")
        chosen |= answer_pages(page, study, "P01", first=3, last=4)
        page.wait(f"JSON.parse(localStorage.getItem('study:{study.id}:P01')).outbox.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    with serving(folder, database, port) as (_, url, _):
        # On another device, the answers so far come from the server.
        page.value("localStorage.clear()")
        page.open(f"{url}?p=P01")
        page.click("#start")
        page.wait("document.getElementById('place').textContent === '5 of 5'")
        chosen |= answer_pages(page, study, "P01", first=4)
        page.wait("document.getElementById('saved').textContent.includes('reached')")
        assert analysed([database], "P01") == expected_answers(study, "P01", chosen)
    page.errors.clear()  # the refused connections
    found = analyze(read_responses([database]), {"t": OneSampleT()}, Settings(resamples=99))
    assert found.checks.attention_answers == 2


def test_every_acknowledged_answer_survives_kill_9(designed, tmp_path):
    """Two writers, and the server killed while they write: what was acknowledged is there."""
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    acknowledged: list[tuple[str, int]] = []

    def write(url: str, participant: str, start: int) -> None:
        for revision in range(start, start + 500):
            try:
                status, _ = post(url, answer(study, participant, "set-01", revision=revision))
            except (OSError, http.client.HTTPException):  # nobody there, or a reply cut short by the kill
                return
            assert status == 200
            acknowledged.append((participant, revision))

    for round_ in range(2):
        with serving(folder, database) as (process, url, _):
            writers = [threading.Thread(target=write, args=(url, name, 1000 * round_ + 1)) for name in ("P01", "P02")]
            for writer in writers:
                writer.start()
            before = len(acknowledged)
            until(lambda target=before + 20: len(acknowledged) > target)
            os.kill(process.pid, signal.SIGKILL)
            for writer in writers:
                writer.join()
    import sqlite3

    with closing(sqlite3.connect(database)) as connection:
        kept = set(connection.execute("SELECT participant, revision FROM answers"))
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert len(acknowledged) > 40
    assert set(acknowledged) <= kept


def test_the_server_takes_in_only_answers_to_its_study(designed, tmp_path):
    study, folder = designed
    with serving(folder, tmp_path / "answers.sqlite") as (process, url, _):
        assert url.startswith("http://127.0.0.1:")
        good = answer(study, "P01", "set-01")
        assert post(url, good) == (200, {"saved": True})
        assert post(url, good) == (200, {"saved": True})  # the page repeats what it had no reply to
        for change in (
            {"study": "another"},
            {"participant": "P99"},
            {"session": "x' OR 1=1"},
            {"item": "set-99"},
            {"question": "nothing"},
            {"score": 6},
            {"score": 0},
            {"score": "3"},
            {"score": True},
            {"revision": 0},
            {"revision": 10**9},
        ):
            assert post(url, {**good, **change})[0] == 400, change
        assert post(url, b"{")[0] == 400
        assert post(url, [1])[0] == 400
        assert post(url, good, kind="text/plain")[0] == 400  # what a page of another site could send
        assert post(url, b"x" * 100_000)[0] == 413
        for place in ("study.json", "../study.json", "pictures/..%2f..%2fstudy.json", "state?participant=P03"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(url + place, timeout=PATIENCE)
            assert refused.value.code == 404
            refused.value.close()
        with urllib.request.urlopen(url + "state?participant=P01", timeout=PATIENCE) as reply:
            assert json.loads(reply.read())["answers"]["set-01"]["style"]["score"] == 2
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def test_changed_answers_and_second_sessions(designed, tmp_path):
    study, _ = designed
    path = tmp_path / "answers.sqlite"
    with closing(Store(study=study, path=path)) as store:
        store.add(answer(study, "P01", "set-01", score=2))
        store.add(answer(study, "P01", "set-01", score=4, revision=2))
        store.add({"study": study.id, "participant": "P01", "session": SESSION, "comment": "=1+1"})
        store.add(answer(study, "P02", "set-01", score=1))
        store.add(answer(study, "P02", "set-01", score=5, session="f" * 16))
        assert store.count() == 3
        assert store.state("P01")["answers"] == {
            "set-01": {"style": {"score": 4, "seconds": 1.5, "time": "2026-01-01T00:00:00Z", "revision": 2}}
        }
        assert store.state("P03") is None
    records = read_responses([path])
    assert records.comments == (("P01", "=1+1"),)
    checks, _ = check(records, scale=Scale(), rules=Rules())
    assert [(finding.kind, finding.participant) for finding in checks.findings] == [("duplicated", "P02")]


def test_a_database_of_another_study_is_refused(designed, tmp_path):
    study, folder = designed
    other, _ = small_study(tmp_path / "other", seed=9)
    Store(study=other, path=tmp_path / "answers.sqlite").close()
    with pytest.raises(ValueError, match=f"holds answers to another study .{other.id}"):
        Store(study=study, path=tmp_path / "answers.sqlite")
    (tmp_path / "text.sqlite").write_text("no database " * 100)
    with pytest.raises(ValueError, match="cannot be used for answers"):
        Store(study=study, path=tmp_path / "text.sqlite")
    next((folder / "pictures").glob("*.jpg")).rename(folder / "kept")
    try:
        with pytest.raises(ValueError, match="lacks 1 picture"):
            static_page(study, folder)
    finally:
        missing = next(name for name in study.pictures if not (folder / "pictures" / f"{name}.jpg").exists())
        (folder / "kept").rename(folder / "pictures" / f"{missing}.jpg")
