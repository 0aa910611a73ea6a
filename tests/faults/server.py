"""The study's server, killed at random moments while participants answer: what it acknowledged is kept."""

import http.client
import random
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path

from study_cases import small_study

import forked
from anystyle.study.protocol import read_study
from anystyle.study.server import serve
from study_serving import answer, claim, post, token_of

PERSONS = ("P01", "P02", "P03")


def kill_server(root: Path, numbers: Sequence[int], seed: int) -> Iterator[tuple[int, tuple[str, str]]]:
    """One database through all kills; of each its number, what is wrong, and how many answers were acknowledged."""
    shutil.rmtree(root, ignore_errors=True)
    study, folder = small_study(root)
    database, last = root / "answers.sqlite", dict.fromkeys(PERSONS, 0)

    def write(url: str, person: str) -> None:
        try:
            if claim(url, study, person)[0] != 200:
                return
            while True:
                revision = last[person] + 1
                message = answer(study, person, "set-001", score=1 + revision % 5, revision=revision)
                if post(url, "answers", message, token_of(person))[0] != 200:
                    return
                last[person] = revision
        except (OSError, http.client.HTTPException, ValueError):
            return  # the server is no more

    for number in numbers:
        draw = random.Random(f"{seed} server {number}")
        address = root / "address.txt"
        address.unlink(missing_ok=True)

        def ready(url: str, address: Path = address) -> None:
            address.with_suffix(".new").write_text(url)
            address.with_suffix(".new").rename(address)

        serving = partial(serve, read_study(folder), folder, database, host="127.0.0.1", port=0, ready=ready)
        child = forked.start((), root, root / "said.txt", instead=serving)
        while not address.is_file():
            time.sleep(0.01)
        before = sum(last.values())
        writers = [threading.Thread(target=write, args=(address.read_text(), person)) for person in PERSONS]
        for writer in writers:
            writer.start()
        time.sleep(draw.uniform(0, 1.5))
        forked.kill(child)
        for writer in writers:
            writer.join()
        yield number, (_lost(database, last), f"{sum(last.values()) - before} answers acknowledged")


def _lost(database: Path, last: dict[str, int]) -> str:
    with closing(sqlite3.connect(database)) as connection:
        if connection.execute("PRAGMA integrity_check").fetchone() != ("ok",):
            return "the database is damaged"
        kept = set(connection.execute("SELECT participant, revision, score FROM answers"))
    lost = {(person, number, 1 + number % 5) for person in PERSONS for number in range(1, last[person] + 1)} - kept
    return f"lost: {sorted(lost)[:3]}" if lost else ""
