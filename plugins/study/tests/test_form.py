"""The form in a real browser, from the first click to the saved answers."""

import json
import time

import pytest

from anystyle_study.page import render, sequence, write_page
from anystyle_study.reading import read_responses
from tests.support.browser import wait
from tests.support.study_cases import LOADED, begin, small_study

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
    times = {row["question"]: row["seconds"] for row in saved["responses"] if row["item"] == second}
    assert times["style"] >= times["content"]  # answered again when the set was shown again
    columns = ("participant", "item", "question", "side", "score", "seconds", "time", "revision")
    assert set(saved["responses"][0]) == set(columns) and errors == []


def test_nothing_is_asked_before_every_picture_is_there(page, designed, tmp_path):
    """Pictures that fail keep the set closed; the seconds are counted from when all can be seen."""
    study, folder = designed
    write_page(study, folder, tmp_path / "form.html")
    page.add_init_script(
        "const fetched = window.fetch;"
        "window.fetch = (url) => window.there ? fetched(url) : Promise.reject(new Error('blocked'));"
    )
    begin(page, f"{(tmp_path / 'form.html').as_uri()}#P03")
    wait(page, "!!document.getElementById('again')")
    blocked = time.monotonic()
    assert page.evaluate("[...document.querySelectorAll('fieldset')].every((field) => field.disabled)")
    page.keyboard.press("3")
    page.click("fieldset[data-question=style] input[value='3']", force=True)
    assert page.evaluate("document.querySelector('fieldset input:checked')") is None
    assert page.evaluate("document.getElementById('next').disabled")
    time.sleep(1)
    page.evaluate("window.there = true")
    page.click("#again")
    wait(page, LOADED)
    assert page.evaluate("[...document.querySelectorAll('img')].every((i) => i.complete && i.naturalWidth > 0)")
    waited = time.monotonic() - blocked
    page.keyboard.press("3")
    given = f"Object.values(JSON.parse(localStorage.getItem('study:{study.id}:P03')).answers)"
    assert 0 <= page.evaluate(f"{given}[0].seconds") < waited - 1


def test_participants_agree_and_say_who_they_are_once(page, tmp_path):
    study, folder = small_study(
        tmp_path,
        sets=2,
        degraded=0,
        consent="You may stop at any time.",
        demographics=[
            {"name": "age", "text": "Your age", "choices": ["18 to 30", "older"]},
            {"name": "job", "text": "Your job"},
        ],
    )
    write_page(study, folder, tmp_path / "form.html")
    begin(page, f"{(tmp_path / 'form.html').as_uri()}#P01")
    wait(page, "!!document.getElementById('agree')")
    assert page.evaluate("document.getElementById('next').disabled")
    page.click("#agree")
    page.click("#next")
    wait(page, "!!document.getElementById('person-age')")
    page.evaluate("document.getElementById('person-age').value = 'older'")
    page.click("#next")
    chosen = answer_pages(page, study, "P01", last=1)
    page.reload()
    page.click("#start")  # neither is asked twice
    chosen |= answer_pages(page, study, "P01", first=1)
    wait(page, "!!document.getElementById('end')")
    with page.expect_download() as download:
        page.click("#end")
    download.value.save_as(file := tmp_path / "answers.json")
    saved = json.loads(file.read_text())
    assert set(saved["person"]) == {"consent", "age"} and saved["person"]["age"] == "older"
    check_positions(study, file, "P01", chosen)


def test_the_page_tells_nobody_which_method_is_which(designed):
    study, _ = designed
    page = render(study, dict.fromkeys(study.pictures, "data:,"))
    for word in ("ours", study.ours + '"', "baseline", "degraded", "scene0", "style0", *study.baselines):
        assert word not in page.partition('id="study">')[2].partition("</script>")[0], word
    assert "</script> styles" not in page.partition("<script")[2].partition("</script>")[0]
    ours, shown = {item.ours for item in study.items}, [sequence(study, one) for one in study.participants]
    first = [entry["A"] in ours for entries in shown for entry in entries]
    assert 0 < sum(first) < len(first)
