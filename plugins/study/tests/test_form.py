"""The form in a real browser, from the first click to the end; and its server, killed between answers."""

import json
import os
import signal
import sqlite3
import time
from contextlib import closing

import pytest

from anystyle_study.command import StudyCommand
from anystyle_study.reading import read_responses
from anystyle_study.server import render, sequence, write_page
from tests.support.browser import wait
from tests.support.study_cases import LOADED, begin, small_study
from tests.support.study_serving import answer, kept_answers, post, serving

SCORES = {"style": 5, "contentA": 3, "contentB": 3}


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"), title="A study of </script> styles")


def answer_pages(page, study, participant, first=0, last=None, by="keys"):
    """Answer pages as a person does; returns the scores given."""
    order = study.participant(participant).order
    chosen = {}
    for index, item in list(enumerate(order))[first:last]:
        wait(page, f"document.getElementById('place').textContent === '{index + 1} of {len(order)}' && {LOADED}")
        assert page.evaluate("document.getElementById('next').disabled")
        for step, (field, levels) in enumerate(SCORES.items()):
            score = 1 + (index + 2 * step) % levels
            chosen[item, field.rstrip("AB"), field[-1] if field[-1] in "AB" else ""] = score
            radio = f"fieldset[data-question={field}] input[value='{score}']"
            page.keyboard.press(str(score)) if by == "keys" else page.click(radio)
        page.keyboard.press("Enter") if by == "keys" else page.click("#next")
    return chosen


def check_positions(study, file, participant, chosen):
    """What the analysis reads has ours where the design put it."""
    records = read_responses([file], study)
    expected = {}
    for (item, question, side), score in chosen.items():
        ours_is_a = item in study.participant(participant).ours_is_a
        method = "" if not side else "ours" if (side == "A") == ours_is_a else "theirs"
        expected[item, question, method, score] = ours_is_a
    assert {(one.item, one.question, one.method, one.score): one.ours_is_a for one in records.answers} == expected


def test_the_static_page_from_first_click_to_saved_answers(page, errors, designed, tmp_path):
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    page.goto(f"{(tmp_path / 'form.html').as_uri()}#P02")
    assert page.evaluate("document.querySelector('h1').textContent") == "A study of </script> styles"
    page.evaluate("document.getElementById('code').value = 'nobody'")
    page.click("#start")
    wait(page, "document.getElementById('codeerror').textContent.includes('not known')")
    page.evaluate("document.getElementById('code').value = ' p02 '")
    page.click("#start")
    chosen = answer_pages(page, study, "P02", last=2, by="mouse")
    # Resumed in the middle, with what was answered kept; back with the keyboard, and an answer changed.
    page.reload()
    page.evaluate("document.getElementById('code').value = 'P02'")
    page.click("#start")
    wait(page, f"document.getElementById('place').textContent === '3 of 5' && {LOADED}")
    page.keyboard.press("Backspace")
    wait(page, f"document.getElementById('place').textContent === '2 of 5' && {LOADED}")
    second = study.participant("P02").order[1]
    assert page.evaluate("document.querySelector('fieldset input:checked').value") == str(chosen[second, "style", ""])
    page.click("fieldset[data-question=style] input[value='5']")
    chosen[second, "style", ""] = 5
    page.click("#next")
    chosen |= answer_pages(page, study, "P02", first=2)
    wait(page, "!!document.getElementById('end')")
    page.click("#comment")
    page.keyboard.insert_text('=cmd|"x"\n<i>fine</i>')
    with page.expect_download() as download:
        page.click("#end")
    assert download.value.suggested_filename.startswith("answers-P02")
    download.value.save_as(file := tmp_path / "answers.json")
    saved = json.loads(file.read_text())
    assert (saved["study"], saved["participant"], saved["comment"]) == (study.id, "P02", '=cmd|"x"\n<i>fine</i>')
    assert {(row["item"], row["question"], row["side"]): row["score"] for row in saved["responses"]} == chosen
    check_positions(study, file, "P02", chosen)
    columns = ("participant", "item", "question", "side", "score", "seconds", "time", "revision")
    assert set(saved["responses"][0]) == set(columns)
    assert errors == []


def test_nothing_is_asked_before_every_picture_is_there(page, designed, tmp_path):
    """Pictures that are blocked keep the set closed; the seconds are counted from when all can be seen."""
    study, folder = designed
    with serving(folder, tmp_path / "answers.sqlite") as (_, url, _):
        page.goto(url)
        page.route("**/pictures/**", lambda route: route.abort())
        begin(page, f"{url}?p=P03")
        wait(page, "!!document.getElementById('again')")
        blocked = time.monotonic()
        assert page.evaluate("[...document.querySelectorAll('fieldset')].every((field) => field.disabled)")
        page.keyboard.press("3")
        page.click("fieldset[data-question=style] input[value='3']", force=True)
        assert page.evaluate("document.querySelector('fieldset input:checked')") is None
        assert page.evaluate("document.getElementById('next').disabled")
        page.click("#again")
        wait(page, "!!document.getElementById('again')")
        time.sleep(1)
        page.unroute("**/pictures/**")
        page.click("#again")
        wait(page, LOADED)
        assert page.evaluate("[...document.querySelectorAll('img')].every((i) => i.complete && i.naturalWidth > 0)")
        waited = time.monotonic() - blocked
        page.keyboard.press("3")
        given = f"Object.values(JSON.parse(localStorage.getItem('study:{study.id}:P03')).answers)"
        assert 0 <= page.evaluate(f"{given}[0].seconds") < waited - 1


@pytest.mark.slow
def test_a_study_survives_its_server_being_killed_between_any_two_answers(page, designed, tmp_path):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    outbox = f"JSON.parse(localStorage.getItem('study:{study.id}:P01')).outbox"
    with serving(folder, database) as (process, url, port):
        begin(page, f"{url}?p=P01")
        chosen = answer_pages(page, study, "P01", last=2)
        wait(page, f"{outbox}.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    # Nobody is stopped, for the next set's pictures are there already; and everybody is told.
    chosen |= answer_pages(page, study, "P01", first=2, last=3)
    wait(page, "!document.getElementById('notice').hidden")
    assert page.evaluate(f"{outbox}.length") == 3
    with serving(folder, database, port) as (process, _, _):
        wait(page, "document.getElementById('notice').hidden")
        if page.evaluate("!!document.getElementById('again')"):
            page.click("#again")
        chosen |= answer_pages(page, study, "P01", first=3, last=4)
        wait(page, f"{outbox}.length === 0")
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    with serving(folder, database, port) as (_, url, _):
        # After a reload, the answers so far come from the server.
        begin(page, f"{url}?p=P01", clear=False)
        wait(page, "document.getElementById('place').textContent === '5 of 5'")
        chosen |= answer_pages(page, study, "P01", first=4)
        wait(page, "!document.getElementById('end')?.disabled")
        assert kept_answers(database, "P01") == chosen
        check_positions(study, database, "P01", chosen)


def test_a_second_browser_is_told_until_the_code_is_released(page, designed, tmp_path, capsys):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (_, url, _):
        begin(page, f"{url}?p=P04")
        chosen = answer_pages(page, study, "P04", last=1)
        wait(page, f"JSON.parse(localStorage.getItem('study:{study.id}:P04')).outbox.length === 0")
        begin(page, f"{url}?p=P04")  # what the first browser had kept is not here
        wait(page, "document.getElementById('codeerror').textContent.includes('another browser')")
        assert kept_answers(database, "P04") == chosen
        StudyCommand()(["form", str(folder), "--database", str(database), "--release", "P04"])
        assert "P04 can go on" in capsys.readouterr().out
        begin(page, f"{url}?p=P04")
        wait(page, f"document.getElementById('place').textContent === '2 of 5' && {LOADED}")
        # Another window of this browser was faster with another answer: the page does not go on over it.
        token = page.evaluate(f"JSON.parse(localStorage.getItem('study:{study.id}:P04')).token")
        second = study.participant("P04").order[1]
        assert post(url, "answers", answer(study, "P04", second, score=1), token)[0] == 200
        page.keyboard.press("5")
        wait(page, "document.body.innerText.includes('answered in another window')")
        assert kept_answers(database, "P04")[second, "style", ""] == 1
        begin(page, f"{url}?p=P04", clear=False)
        wait(page, f"document.getElementById('place').textContent === '2 of 5' && {LOADED}")
        assert page.evaluate("document.querySelector('fieldset input:checked').value") == "1"


@pytest.mark.slow
def test_recruited_participants_agree_answer_and_go_back_with_a_code(page, tmp_path):
    """The whole way of one of Prolific's participants: id, consent, demographics, sets, code, and back."""
    visited = []
    page.route("https://back.example/**", lambda route: visited.append(route.request.url) or route.fulfill(body="Back"))
    study, folder = small_study(
        tmp_path,
        consent="You may stop at any time.",
        demographics=[
            {"name": "age", "text": "Your age", "choices": ["18 to 30", "older"]},
            {"name": "job", "text": "Your job"},
        ],
        id_parameters=["PROLIFIC_PID", "workerId"],
        completion_url="https://back.example/complete?cc={code}",
        completion_code="C0FFEE",
    )
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (_, url, _):
        page.goto(f"{url}?workerId=A1&assignmentId=ASSIGNMENT_ID_NOT_AVAILABLE")
        assert page.evaluate("document.getElementById('start').disabled")
        assert "C0FFEE" not in page.evaluate("document.documentElement.outerHTML")
        begin(page, f"{url}?PROLIFIC_PID=5f1e&STUDY_ID=1&SESSION_ID=2")
        wait(page, "!!document.getElementById('agree')")
        assert page.evaluate("document.getElementById('next').disabled")
        page.click("#agree")
        page.click("#next")
        wait(page, "!!document.getElementById('person-age')")
        page.evaluate("document.getElementById('person-age').value = 'older'")
        page.click("#next")
        chosen = answer_pages(page, study, "P01", last=2)
        wait(page, f"JSON.parse(localStorage.getItem('study:{study.id}:5f1e')).outbox.length === 0")
        begin(page, f"{url}?PROLIFIC_PID=5f1e", clear=False)  # neither consent nor demographics are asked twice
        chosen |= answer_pages(page, study, "P01", first=2)
        wait(page, "!document.getElementById('end')?.disabled")
        page.click("#comment")
        page.keyboard.insert_text("Fine.")
        page.click("#end")
        wait(page, "document.getElementById('completion')?.textContent === 'C0FFEE'")
        wait(page, "document.body.innerText === 'Back'")
    assert visited == ["https://back.example/complete?cc=C0FFEE"]
    assert kept_answers(database, "P01") == chosen
    with closing(sqlite3.connect(database)) as connection:
        facts = dict(connection.execute("SELECT name, value FROM people WHERE participant = 'P01'").fetchall())
        comments = connection.execute("SELECT comment FROM responses WHERE comment IS NOT NULL").fetchall()
    assert comments == [("Fine.",)]
    assert set(facts) == {"consent", "age"} and facts["age"] == "older"


def test_the_page_tells_nobody_which_method_is_which(designed):
    study, _ = designed
    pictures = dict.fromkeys(study.pictures, "data:,")
    for page in (render(study), render(study, pictures)):
        for word in ("ours", study.ours + '"', "baseline", "degraded", "scene0", "style0", *study.baselines):
            assert word not in page.partition('id="study">')[2].partition("</script>")[0], word
        assert "</script> styles" not in page.partition("<script")[2].partition("</script>")[0]
    ours, shown = {item.ours for item in study.items}, [sequence(study, one) for one in study.participants]
    first = [entry["A"] in ours for entries in shown for entry in entries]
    assert 0 < sum(first) < len(first)
