"""The study's server and store: what is acknowledged stays, and nobody reads, blocks or overwrites another."""

import http.client
import os
import signal
import sqlite3
import threading
import time
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing

import msgspec
import numpy as np
import pytest

from anystyle_study.server import write_page
from anystyle_study.store import Claim, Fact, PostedAnswer, Refused, SessionMessage, Store
from tests.support.browser import until
from tests.support.study_cases import small_study
from tests.support.study_serving import PATIENCE, answer, claim, kept_answers, post, serving, token_of


@pytest.fixture(scope="module")
def designed(tmp_path_factory):
    return small_study(tmp_path_factory.mktemp("study"))


@pytest.fixture
def store(designed, tmp_path):
    with closing(Store(study=designed[0], path=tmp_path / "answers.sqlite")) as opened:
        yield opened


@pytest.mark.parametrize("kills", [1, pytest.param(50, marks=pytest.mark.slow)])
def test_every_acknowledged_answer_survives_kill_9(designed, tmp_path, kills):
    """Two writers, and the server killed at random while they write: what was acknowledged is there."""
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    acknowledged: dict[str, int] = {"P01": 0, "P02": 0}

    def write(url: str, participant: str) -> None:
        try:
            assert claim(url, study, participant)[0] == 200
            for revision in range(acknowledged[participant] + 1, acknowledged[participant] + 501):
                message = answer(study, participant, "set-001", score=1 + revision % 5, revision=revision)
                status, _ = post(url, "answers", message, token_of(participant))
                assert status == 200
                acknowledged[participant] = revision
        except (OSError, http.client.HTTPException, ValueError):
            return  # nobody there, or a reply cut short by the kill, in its head or in its body

    random = np.random.default_rng(0)
    for _ in range(kills):
        with serving(folder, database) as (process, url, _):
            writers = [threading.Thread(target=write, args=(url, name)) for name in acknowledged]
            for writer in writers:
                writer.start()
            target = sum(acknowledged.values()) + 1 + int(random.integers(40))
            until(lambda target=target: sum(acknowledged.values()) > target)
            time.sleep(random.uniform(0, 0.02))
            os.kill(process.pid, signal.SIGKILL)
            for writer in writers:
                writer.join()
    with closing(sqlite3.connect(database)) as connection:
        kept = set(connection.execute("SELECT participant, revision, score FROM answers"))
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
    assert sum(acknowledged.values()) > 2 * kills
    assert {
        (name, revision, 1 + revision % 5) for name, last in acknowledged.items() for revision in range(1, last + 1)
    } <= kept


def test_the_server_takes_in_only_answers_to_its_study(designed, tmp_path):
    study, folder = designed
    with serving(folder, tmp_path / "answers.sqlite") as (process, url, _):
        assert url.startswith("http://127.0.0.1:")
        status, session = claim(url, study, "p01")
        assert (status, session["participant"], session["answers"]) == (200, "P01", [])
        assert [claim(url, study, code)[0] for code in ("P99", "P01-2", "../P01", "")] == [404, 404, 400, 400]
        good, token = answer(study, "P01", "set-001"), token_of("p01")
        assert post(url, "answers", good, token) == (200, {"saved": True})
        assert post(url, "answers", good, token) == (200, {"saved": True})  # what the page had no reply to
        wrong = [{"study": "another"}, {"item": "set-099"}, {"question": "nothing"}, {"question": "content"}]
        wrong += [{"side": "A"}, {"seconds": -1}, {"revision": 0}, {"revision": 10**9}, {"ours_is": "A"}]
        for change in (*wrong, *({"score": score} for score in (6, 0, "3", True))):
            assert post(url, "answers", {**good, **change}, token)[0] == 400, change
        for content in (b"{", b"[" * 60_000, [1]):
            assert post(url, "answers", content, token)[0] == 400
        assert post(url, "answers", good, token, kind="text/plain")[0] == 400  # what a page of another site could send
        assert post(url, "nothing", good, token)[0] == 404
        assert post(url, "answers", b"x" * 100_000, token)[0] == 413
        comment = {"study": study.id, "participant": "P01", "name": "comment", "value": "x" * 10_001}
        assert post(url, "facts", comment, token)[0] == 413
        assert post(url, "facts", {**comment, "value": "x" * 10_000}, token)[0] == 200
        assert post(url, "facts", {**comment, "name": "age", "value": "3"}, token)[0] == 400
        for path in ("study.json", "../study.json", "pictures/..%2f..%2fstudy.json", "state?participant=P01"):
            with pytest.raises(urllib.error.HTTPError) as refused:
                urllib.request.urlopen(url + path, timeout=PATIENCE)
            assert refused.value.code == 404
            refused.value.close()
        process.send_signal(signal.SIGINT)
        assert process.wait(PATIENCE) == 0


def test_nobody_reads_or_blocks_anothers_session(designed, tmp_path):
    study, folder = designed
    with serving(folder, tmp_path / "answers.sqlite") as (_, url, _):
        claim(url, study, "P01")
        stranger = "f" * 32
        assert post(url, "session", {"study": study.id, "person": "P01", "token": stranger})[0] == 409
        assert post(url, "answers", answer(study, "P01", "set-001"), stranger)[0] == 401
        assert post(url, "answers", answer(study, "P01", "set-001"))[0] == 401
        assert post(url, "answers", answer(study, "P02", "set-001"), token_of("P01"))[0] == 401
        assert post(url, "finish", {"study": study.id, "participant": "P01"}, stranger)[0] == 401
        ahead = answer(study, "P01", "set-001", revision=999_999)
        assert post(url, "answers", ahead, token_of("P01"))[0] == 409  # it would silence every later answer
        assert post(url, "answers", answer(study, "P01", "set-001", score=4), token_of("P01"))[0] == 200
        other = answer(study, "P01", "set-001", score=5)
        assert post(url, "answers", other, token_of("P01"))[0] == 409  # the same revision, another score
        assert kept_answers(tmp_path / "answers.sqlite", "P01") == {("set-001", "style", ""): 4}


@pytest.mark.parametrize(("suffix", "replaced"), [("", False), ("", True), ("-wal", False)])
def test_answers_are_not_acknowledged_without_their_file(designed, tmp_path, suffix, replaced):
    study, folder = designed
    database = tmp_path / "answers.sqlite"
    with serving(folder, database) as (_, url, _):
        claim(url, study, "P01")
        assert post(url, "answers", answer(study, "P01", "set-001"), token_of("P01"))[0] == 200
        file = database.with_name(database.name + suffix)
        file.rename(tmp_path / "elsewhere")
        if replaced:
            file.write_bytes((tmp_path / "elsewhere").read_bytes())
        assert post(url, "answers", answer(study, "P01", "set-002"), token_of("P01"))[0] == 503
        assert claim(url, study, "P02")[0] == 503


def test_assignment_is_balanced_and_idempotent(tmp_path):
    study, folder = small_study(tmp_path, id_parameters=["id"])
    with closing(Store(study=study, path=folder / "answers.sqlite")) as store:

        def assigned(person: str) -> str:
            return store.claim(Claim(study.id, person, token_of(person)))["participant"]

        with ThreadPoolExecutor(8) as pool:
            assert len(set(pool.map(assigned, ["same"] * 20))) == 1
        assert [assigned(f"p{number}") for number in range(3)] == ["P02", "P03", "P04"]
        assert [assigned(f"p{number}") for number in range(3)] == ["P02", "P03", "P04"]
        # Whoever began two hours ago and has answered nothing since has left; others see what they would have.
        with closing(sqlite3.connect(folder / "answers.sqlite")) as connection, connection:
            connection.execute("UPDATE sessions SET started = '2020-01-01T00:00:00.000+00:00' WHERE slot = 'P03'")
        assert assigned("late") == "P03-2"
        assert study.participant("P03-2") == study.participant("P03")
        assert assigned("p1") == "P03"  # and may come back
        # A clock that is set back makes nobody leave.
        with closing(sqlite3.connect(folder / "answers.sqlite")) as connection, connection:
            connection.execute("UPDATE sessions SET started = '2999-01-01T00:00:00.000+00:00' WHERE slot = 'P04'")
        assert assigned("later") == "P01-2"


def test_the_end_is_told_once_every_answer_is_kept(designed, store):
    study, _ = designed
    store.claim(Claim(study.id, "P01", token_of("P01")))
    order = study.participant("P01").order
    sides = [("style", ""), ("content", "A"), ("content", "B")]
    for item in order:
        for question, side in sides:
            with pytest.raises(Refused, match=r"\d+ answers are missing"):
                store.finish(SessionMessage(study.id, "P01"), token_of("P01"))
            message = msgspec.convert(answer(study, "P01", item, question, 2, side), PostedAnswer)
            store.add(message, token_of("P01"))
    assert store.finish(SessionMessage(study.id, "P01"), token_of("P01")) == {"code": "", "url": ""}
    assert len(store.claim(Claim(study.id, "P01", token_of("P01")))["answers"]) == 3 * len(order)


def test_changed_answers_and_comments(designed, store, tmp_path):
    study, _ = designed
    store.claim(Claim(study.id, "P01", token_of("P01")))
    for score, revision in ((2, 1), (4, 2)):
        message = msgspec.convert(answer(study, "P01", "set-001", score=score, revision=revision), PostedAnswer)
        store.add(message, token_of("P01"))
        store.note(Fact(study.id, "P01", "comment", f"=1+{revision}"), token_of("P01"))
    with closing(sqlite3.connect(tmp_path / "answers.sqlite")) as connection:
        connection.row_factory = sqlite3.Row
        (row,) = connection.execute("SELECT * FROM responses").fetchall()
    assert dict(row) == {**answer(study, "P01", "set-001", score=4, revision=2), "comment": "=1+2"}
    again = store.claim(Claim(study.id, "P01", token_of("P01")))
    assert (again["answers"][0]["score"], again["facts"]) == (4, {"comment": "=1+2"})


def test_a_database_of_another_study_is_refused(designed, tmp_path):
    study, folder = designed
    other, _ = small_study(tmp_path / "other", seed=9)
    Store(study=other, path=tmp_path / "answers.sqlite").close()
    with pytest.raises(ValueError, match=f"holds answers to another study .{other.id}"):
        Store(study=study, path=tmp_path / "answers.sqlite")
    (tmp_path / "text.sqlite").write_text("no database " * 100)
    with pytest.raises(ValueError, match="cannot be used for answers"):
        Store(study=study, path=tmp_path / "text.sqlite")
    lost = next((folder / "pictures").glob("*.jpg"))
    lost.rename(folder / "kept")
    with pytest.raises(ValueError, match=f"lacks 1 pictures, such as {lost.name}"):
        write_page(study, folder, tmp_path / "form.html")
    (folder / "kept").rename(lost)
