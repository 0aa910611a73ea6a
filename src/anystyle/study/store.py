"""Sessions and answers kept durably in SQLite, one append an answer."""

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

from anystyle.study.protocol import Participant, Study

_LONGEST_TEXT = 10_000
_ABANDONED = timedelta(hours=1)
"""Without an answer, after which what a participant was to see is given to another one too."""


class Claim(Struct, frozen=True, forbid_unknown_fields=True):
    """What begins or resumes a session: who, and the secret that the browser made for it."""

    study: str
    person: Annotated[str, Meta(pattern=r"^[\w.@+-]{1,100}$")]
    token: Annotated[str, Meta(pattern=r"^[0-9a-f]{32}$")]


class Message(Struct, frozen=True, forbid_unknown_fields=True):
    """What a session sends; by itself, the wish to finish."""

    study: str
    participant: str


class Answer(Message, frozen=True, forbid_unknown_fields=True):
    """One answer; ``side`` is empty for a comparison, ``A`` or ``B`` for a rating."""

    item: str
    question: str
    side: str
    score: int
    seconds: Annotated[float, Meta(ge=0, lt=1e7)]
    time: Annotated[str, Meta(max_length=40)]
    revision: Annotated[int, Meta(ge=1, lt=1_000_000)]


class Fact(Message, frozen=True, forbid_unknown_fields=True):
    """Something that a participant says once: consent, a demographic, a comment."""

    name: str
    value: str


class Refused(Exception):
    """A message that is not kept.

    Args:
        status: Of HTTP: 400 does not fit the study, 401 is another's, 404 nobody, 409 contradicts what is kept, 413 is
            too long.
        reason: In words.
    """

    def __init__(self, status: int, reason: str) -> None:
        super().__init__(reason)
        self.status = status


class Store:
    """The sessions and answers of one study.

    What is kept is on the disk before a method returns: the journal is written ahead and synchronised at every commit,
    and the file is looked for where it was opened. An answer that arrives twice is kept once; a changed one is a new
    row with the next revision, and the view ``responses`` shows the last.

    Args:
        study: Whose answers.
        path: The SQLite file; made where there is none.

    Raises:
        ValueError: The file holds another study's answers, or is no SQLite file.
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
            held = self._database.execute("SELECT id FROM study").fetchone()
        except sqlite3.DatabaseError as error:
            raise ValueError(f"{path} cannot be used for answers: {error}; name another file") from None
        if held is None:
            self._database.execute("INSERT INTO study VALUES (?)", (study.id,))
        elif held[0] != study.id:
            self.close()
            raise ValueError(f"{path} holds answers to another study ({held[0]}, not {study.id}); name another file")
        self._files = {file: file.stat().st_ino for file in (path, path.with_name(path.name + "-wal"))}
        folder = os.open(path.parent, os.O_RDONLY)
        os.fsync(folder)  # the files' names are to last, too
        os.close(folder)

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    @contextmanager
    def _change(self) -> Iterator[sqlite3.Connection]:
        """A transaction that is on the disk, in the files that are there, when the block has ended."""
        with self._lock:
            self._database.execute("BEGIN IMMEDIATE")
            try:
                yield self._database
                self._database.execute("COMMIT")
            except BaseException:
                if self._database.in_transaction:
                    self._database.execute("ROLLBACK")
                raise
            for file, inode in self._files.items():
                if file.stat().st_ino != inode:
                    raise OSError(f"{file} was replaced while the study is served")

    def claim(self, message: Claim) -> dict[str, Any]:
        """Begin a person's session, or resume it in the browser that began it; what the page needs to go on.

        Without ``id_parameters``, persons are the design's codes. With them, whoever comes is assigned what fewest
        others have seen or are seeing, always the same.

        Raises:
            Refused: The code is not known, or is in use in another browser.
        """
        self._belongs(message.study)
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
                database.execute(
                    "INSERT INTO sessions VALUES (?, ?, ?, ?, ?, NULL)", (row[0], slot, person, digest, _now())
                )
            elif row[1] is None:
                database.execute("UPDATE sessions SET token = ? WHERE person = ?", (digest, person))
            elif row[1] != digest:
                raise Refused(409, "this code is in use in another browser")
            return {"participant": row[0], **self._state(row[0])}

    def _free_slot(self) -> str:
        """What fewest have finished or are at, then fewest have begun, then comes first: balanced in this order."""
        since = _now(-_ABANDONED)
        rows = self._database.execute(
            "SELECT slot, finished IS NOT NULL OR started > ?1 OR EXISTS (SELECT 1 FROM answers WHERE "
            "answers.participant = sessions.participant AND received > ?1) FROM sessions",
            (since,),
        ).fetchall()
        begun, taken = Counter(slot for slot, _ in rows), Counter(slot for slot, counts in rows if counts)
        return min(
            (participant.id for participant in self._study.participants), key=lambda slot: (taken[slot], begun[slot])
        )

    def _state(self, participant: str) -> dict[str, Any]:
        columns = ("item", "question", "side", "score", "seconds", "time", "revision")
        answers = self._database.execute(
            f"SELECT {', '.join(columns)} FROM responses WHERE participant = ?", (participant,)
        )
        facts = self._database.execute("SELECT name, value FROM facts WHERE participant = ?", (participant,))
        return {"answers": [dict(zip(columns, row, strict=True)) for row in answers], "facts": dict(facts.fetchall())}

    def release(self, person: str) -> None:
        """Let a person go on in another browser.

        Raises:
            ValueError: No such person has begun.
        """
        with self._change() as database:
            if not database.execute("UPDATE sessions SET token = NULL WHERE person = ?", (person,)).rowcount:
                raise ValueError(f"nobody has begun as {person!r}; name a code or an id as the participant entered it")

    def add(self, message: Answer, token: str) -> None:
        """Keep one answer.

        Raises:
            Refused: It does not fit the study, is another's, or contradicts one that is kept.
        """
        participant = self._authorized(message, token)
        question = self._questions.get(message.question)
        if message.item not in participant.order:
            raise Refused(400, "the set is not one of this participant's")
        if question is None or message.side not in question.sides:
            raise Refused(400, "the question is not known")
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
        """Keep what a participant says once; the last counts.

        Raises:
            Refused: It does not fit the study, is another's, or too long.
        """
        self._authorized(message, token)
        if message.name not in self._facts:
            raise Refused(400, "this is not asked")
        if len(message.value) > _LONGEST_TEXT:
            raise Refused(413, f"a text has at most {_LONGEST_TEXT} characters")
        with self._change() as database:
            query = "INSERT OR REPLACE INTO facts VALUES (?, ?, ?)"
            database.execute(query, (message.participant, message.name, message.value))

    def finish(self, message: Message, token: str) -> dict[str, str]:
        """The code and the address for the end, once every answer is kept.

        Raises:
            Refused: Answers are missing, or it is another's wish.
        """
        participant = self._authorized(message, token)
        expected = len(participant.order) * sum(len(question.sides) for question in self._questions.values())
        with self._change() as database:
            query = "SELECT count(*) FROM responses WHERE participant = ?"
            (kept,) = database.execute(query, (message.participant,)).fetchone()
            if kept < expected:
                raise Refused(409, f"{expected - kept} answers are missing")
            query = "UPDATE sessions SET finished = coalesce(finished, ?) WHERE participant = ?"
            database.execute(query, (_now(), message.participant))
        plan = self._study.plan
        return {"code": plan.completion_code, "url": plan.completion_url.replace("{code}", plan.completion_code)}

    def _belongs(self, study: str) -> None:
        if study != self._study.id:
            raise Refused(400, "this belongs to another study")

    def _authorized(self, message: Message, token: str) -> Participant:
        self._belongs(message.study)
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
