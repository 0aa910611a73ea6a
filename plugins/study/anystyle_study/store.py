"""Sessions and answers, stored durably in SQLite: one row per answer."""

import hashlib
import os
import sqlite3
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct

from anystyle.errors import UserError
from anystyle_study.protocol import Participant, Study

_MAX_TEXT = 10_000
_ABANDONED = timedelta(hours=1)  # without an answer; then a participant's slot is given to another person too


class Claim(Struct, frozen=True, forbid_unknown_fields=True):
    """Begins or resumes a session: the person, and the secret that the browser generated for it."""

    study: str
    person: Annotated[str, Meta(pattern=r"^[\w.@+-]{1,100}$")]
    token: Annotated[str, Meta(pattern=r"^[0-9a-f]{32}$")]


class SessionMessage(Struct, frozen=True, forbid_unknown_fields=True):
    """A message of a session; without more fields, a request to finish."""

    study: str
    participant: str


class PostedAnswer(SessionMessage, frozen=True, forbid_unknown_fields=True):
    """One answer; ``side`` is empty for a comparison, ``A`` or ``B`` for a rating."""

    item: str
    question: str
    side: str
    score: int
    seconds: Annotated[float, Meta(ge=0, lt=1e7)]
    time: Annotated[str, Meta(max_length=40)]
    revision: Annotated[int, Meta(ge=1, lt=1_000_000)]


class Fact(SessionMessage, frozen=True, forbid_unknown_fields=True):
    """A text about the participant: consent, a demographic, a comment."""

    name: str
    value: str


class Refused(Exception):
    """A message that is not stored.

    Its HTTP status is 400 if it does not fit the study, 401 if it belongs to another session, 404 for an unknown code,
    409 if it contradicts what is stored, 413 if it is too long.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Store:
    """The sessions and answers of one study.

    Methods return once the data are on the disk (write-ahead log, synchronised at every commit), in the file that was
    opened. An answer that arrives twice is stored once; a changed answer is a new row with the next revision, and the
    view ``responses`` shows the last.
    """

    def __init__(self, *, study: Study, path: Path) -> None:
        self._study = study
        self._questions = {question.name: question for question in study.plan.questions}
        self._facts = {"consent", "comment", *(question.name for question in study.plan.demographics)}
        self._lock = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._database = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.executescript(Path(__file__).with_name("tables.sql").read_text(encoding="utf-8"))
            self._database.execute("INSERT INTO study SELECT ? WHERE NOT EXISTS (SELECT * FROM study)", (study.id,))
            (held,) = self._database.execute("SELECT id FROM study").fetchone()
        except sqlite3.DatabaseError as error:
            raise UserError(f"{path} cannot be used for answers: {error}; name another file") from None
        if held != study.id:
            self.close()
            raise UserError(f"{path} holds answers to another study ({held}, not {study.id}); name another file")
        self._files = {file: file.stat().st_ino for file in (path, path.with_name(path.name + "-wal"))}
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)  # so that the file names are durable
        os.close(folder)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    @contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        """A transaction that is on the disk at the end of the block; fails if the files were replaced."""
        with self._lock:
            self._database.execute("BEGIN IMMEDIATE")
            with self._database:  # commits, or rolls back
                yield self._database
            for file, inode in self._files.items():
                if file.stat().st_ino != inode:
                    raise OSError(f"{file} was replaced while the study is served")

    def claim(self, message: Claim) -> dict[str, Any]:
        """Begin a person's session, or resume it in the browser that began it; returns the session's state.

        Without ``id_parameters``, persons are the design's codes. With them, a new person is assigned the slot that
        the fewest others have taken.
        """
        self._belongs(message)
        assigned = bool(self._study.plan.id_parameters)
        person = message.person if assigned else message.person.upper()
        if not assigned and person not in {participant.id for participant in self._study.participants}:
            raise Refused(404, "this code is not known")
        digest = _digest(message.token)
        with self._change() as database:
            row = database.execute("SELECT participant, token FROM sessions WHERE person = ?", (person,)).fetchone()
            if row is None:
                slot = self._free_slot() if assigned else person
                (times,) = database.execute("SELECT count(*) FROM sessions WHERE slot = ?", (slot,)).fetchone()
                row = f"{slot}-{times + 1}" if times else slot, digest
                values = (row[0], slot, person, digest, _now())
                database.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?, NULL)", values)
            elif row[1] is None:
                database.execute("UPDATE sessions SET token = ? WHERE person = ?", (digest, person))
            elif row[1] != digest:
                raise Refused(409, "this code is in use in another browser")
            columns = ("item", "question", "side", "score", "seconds", "time", "revision")
            query = f"SELECT {', '.join(columns)} FROM responses WHERE participant = ?"
            answers = [dict(zip(columns, kept, strict=True)) for kept in database.execute(query, row[:1])]
            facts = database.execute("SELECT name, value FROM facts WHERE participant = ?", row[:1]).fetchall()
            return {"participant": row[0], "answers": answers, "facts": dict(facts)}

    def _free_slot(self) -> str:
        """The slot that the fewest have finished or are working on, then the fewest have begun, then the first."""
        query = (
            "SELECT slot, finished IS NOT NULL OR started > ?1 OR EXISTS (SELECT 1 FROM answers WHERE "
            "answers.participant = sessions.participant AND received > ?1) FROM sessions"
        )
        rows = self._database.execute(query, (_now(-_ABANDONED),)).fetchall()
        begun, taken = Counter(slot for slot, _ in rows), Counter(slot for slot, counts in rows if counts)
        return min((one.id for one in self._study.participants), key=lambda slot: (taken[slot], begun[slot]))

    def release(self, person: str) -> None:
        """Let a person go on in another browser."""
        with self._change() as database:
            if not database.execute("UPDATE sessions SET token = NULL WHERE person = ?", (person,)).rowcount:
                raise UserError(f"no session of {person!r} exists; give the code or id that the participant entered")

    def add(self, message: PostedAnswer, token: str) -> None:
        """Store one answer."""
        question = self._questions.get(message.question)
        order = self._authorized(message, token).order
        if message.item not in order or question is None or message.side not in question.sides:
            raise Refused(400, "the set or the question is not one of this participant's")
        if not question.scale.low <= message.score <= question.scale.high:
            raise Refused(400, "the score is outside the scale")
        key = (message.participant, message.item, message.question, message.side)
        with self._change() as database:
            query = "SELECT revision, score FROM answers WHERE (participant, item, question, side) = (?, ?, ?, ?)"
            kept = dict(database.execute(query, key).fetchall())
            if message.revision not in kept and message.revision == len(kept) + 1:
                values = (_now(), *key, message.score, message.seconds, message.time, message.revision)
                database.execute("INSERT INTO answers VALUES (NULL, ?, ?, ?, ?, ?, ?, ?, ?, ?)", values)
            elif kept.get(message.revision) != message.score:
                raise Refused(409, f"answers to this question have revisions up to {len(kept)}, and this is another")

    def note(self, message: Fact, token: str) -> None:
        """Store a text about the participant; the last one counts."""
        self._authorized(message, token)
        if message.name not in self._facts:
            raise Refused(400, "this is not asked")
        if len(message.value) > _MAX_TEXT:
            raise Refused(413, f"a text has at most {_MAX_TEXT} characters")
        with self._change() as database:
            values = (message.participant, message.name, message.value)
            database.execute("INSERT OR REPLACE INTO facts VALUES (?, ?, ?)", values)

    def finish(self, message: SessionMessage, token: str) -> dict[str, str]:
        """Completion code and address, once every answer is stored."""
        order, who = self._authorized(message, token).order, message.participant
        expected = len(order) * sum(len(question.sides) for question in self._questions.values())
        with self._change() as database:
            (kept,) = database.execute("SELECT count(*) FROM responses WHERE participant = ?", (who,)).fetchone()
            if kept < expected:
                raise Refused(409, f"{expected - kept} answers are missing")
            query = "UPDATE sessions SET finished = coalesce(finished, ?) WHERE participant = ?"
            database.execute(query, (_now(), who))
        plan = self._study.plan
        return {"code": plan.completion_code, "url": plan.completion_url.replace("{code}", plan.completion_code)}

    def _belongs(self, message: Claim | SessionMessage) -> None:
        if message.study != self._study.id:
            raise Refused(400, "this belongs to another study")

    def _authorized(self, message: SessionMessage, token: str) -> Participant:
        self._belongs(message)
        query = "SELECT token FROM sessions WHERE participant = ?"
        with self._lock:
            row = self._database.execute(query, (message.participant,)).fetchone()
        participant = self._study.participant(message.participant)
        if participant is None or row is None or row[0] != _digest(token):
            raise Refused(401, "this session goes on in another browser")
        return participant


def _now(offset: timedelta = timedelta()) -> str:
    return (datetime.now(UTC) + offset).isoformat(timespec="milliseconds")


def _digest(token: str) -> str:
    return hashlib.sha256(token.encode()).hexdigest()
