"""Answers kept durably in SQLite, one append an answer."""

import contextlib
import re
import sqlite3
import threading
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from anystyle.study.form import comparison
from anystyle.study.protocol import Study

_TABLES = """
CREATE TABLE IF NOT EXISTS study (id TEXT NOT NULL);
CREATE TABLE IF NOT EXISTS answers (
    id INTEGER PRIMARY KEY, received TEXT NOT NULL, participant TEXT NOT NULL, session TEXT NOT NULL,
    item TEXT NOT NULL, question TEXT NOT NULL, score INTEGER NOT NULL, ours_is TEXT NOT NULL, expected INTEGER,
    comparison TEXT NOT NULL, seconds REAL, time TEXT, revision INTEGER NOT NULL,
    UNIQUE (participant, session, item, question, revision)
);
CREATE TABLE IF NOT EXISTS comments (
    id INTEGER PRIMARY KEY, received TEXT NOT NULL, participant TEXT NOT NULL, session TEXT NOT NULL,
    comment TEXT NOT NULL
);
CREATE VIEW IF NOT EXISTS responses AS
    WITH last AS (
        SELECT * FROM answers WHERE revision = (
            SELECT max(revision) FROM answers AS other WHERE other.participant = answers.participant
            AND other.session = answers.session AND other.item = answers.item AND other.question = answers.question
        )
    )
    SELECT participant, item, question, score, ours_is, expected, comparison, seconds, time, session, revision,
        CASE WHEN id = (SELECT min(id) FROM last AS first WHERE first.participant = last.participant)
            THEN (SELECT comment FROM comments WHERE comments.participant = last.participant ORDER BY id DESC LIMIT 1)
        END AS comment
    FROM last ORDER BY id;
"""
_ADD = """
INSERT OR IGNORE INTO answers
    (received, participant, session, item, question, score, ours_is, expected, comparison, seconds, time, revision)
VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)
"""
_LONGEST_COMMENT = 10_000
_SESSION = re.compile(r"[0-9a-f]{16}")


class Store:
    """The answers to one study.

    An answer is on the disk before :meth:`add` returns: the journal is written ahead and synchronised at every
    commit. An answer that arrives twice is kept once; a changed one is a new row, and the view ``responses`` shows the
    last. Two sessions of one participant are both kept.

    Args:
        study: Whose answers.
        path: The SQLite file; made where there is none.

    Raises:
        ValueError: The file holds another study's answers, or is no SQLite file.
    """

    def __init__(self, *, study: Study, path: Path) -> None:
        self._study = study
        self._items = {item.id: item for item in study.items}
        self._checks = {check.id: check for check in study.checks}
        self._participants = {participant.id: participant for participant in study.participants}
        self._questions = {question.name for question in study.plan.questions}
        self._lock = threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            self._database = sqlite3.connect(path, check_same_thread=False, isolation_level=None)
            self._database.execute("PRAGMA journal_mode=WAL")
            self._database.execute("PRAGMA synchronous=FULL")
            self._database.executescript(_TABLES)
            held = self._database.execute("SELECT id FROM study").fetchone()
        except sqlite3.DatabaseError as error:
            raise ValueError(f"{path} cannot be used for answers: {error}; name another file") from None
        if held is None:
            self._database.execute("INSERT INTO study VALUES (?)", (study.id,))
        elif held[0] != study.id:
            self.close()
            raise ValueError(f"{path} holds answers to another study ({held[0]}, not {study.id}); name another file")

    def close(self) -> None:
        """Close the file."""
        self._database.close()

    def add(self, message: Mapping[str, Any]) -> None:
        """Keep one answer or one comment, as the page sends it.

        Raises:
            ValueError: It does not fit the study.
        """
        if message.get("study") != self._study.id:
            raise ValueError("the answer belongs to another study")
        participant = self._participants.get(str(message.get("participant")))
        session = message.get("session")
        if participant is None or not isinstance(session, str) or not _SESSION.fullmatch(session):
            raise ValueError("participant or session is not known")
        received = datetime.now(UTC).isoformat(timespec="milliseconds")
        if "comment" in message:
            comment = str(message["comment"])[:_LONGEST_COMMENT]
            statement = "INSERT INTO comments (received, participant, session, comment) VALUES (?, ?, ?, ?)"
            values: tuple[Any, ...] = (received, participant.id, session, comment)
        else:
            statement = _ADD
            item, question, score, revision = self._checked(message)
            judged, check = self._items.get(item), self._checks.get(item)
            values = (
                *(received, participant.id, session, item, question, score),
                ("A" if item in participant.ours_is_a else "B") if judged else "",
                check.expected if check else None,
                comparison(self._study, judged.baseline) if judged and len(self._study.baselines) > 1 else "",
                _seconds(message.get("seconds")),
                str(message.get("time", ""))[:40],
                revision,
            )
        with self._lock:
            self._database.execute(statement, values)

    def _checked(self, message: Mapping[str, Any]) -> tuple[str, str, int, int]:
        item, question = str(message.get("item")), str(message.get("question"))
        score, revision = message.get("score"), message.get("revision", 1)
        scale = self._study.plan.scale
        if item not in self._items and item not in self._checks:
            raise ValueError("the set is not known")
        if question not in self._questions:
            raise ValueError("the question is not known")
        if not isinstance(score, int) or isinstance(score, bool) or not scale.low <= score <= scale.high:
            raise ValueError("the score is outside the scale")
        if not isinstance(revision, int) or isinstance(revision, bool) or not 1 <= revision < 1_000_000:
            raise ValueError("the revision is no number")
        return item, question, score, revision

    def state(self, participant: str) -> dict[str, Any] | None:
        """What the page needs to go on with a participant's last session; ``None`` where there is none."""
        with self._lock:
            last = self._database.execute(
                "SELECT session FROM answers WHERE participant = ? ORDER BY id DESC LIMIT 1", (participant,)
            ).fetchone()
            if last is None:
                return None
            rows = self._database.execute(
                "SELECT item, question, score, seconds, time, revision FROM responses "
                "WHERE participant = ? AND session = ?",
                (participant, last[0]),
            ).fetchall()
        answers: dict[str, dict[str, Any]] = {}
        for item, question, score, seconds, time, revision in rows:
            answers.setdefault(item, {})[question] = {
                "score": score, "seconds": seconds, "time": time, "revision": revision,
            }  # fmt: skip
        return {"session": last[0], "answers": answers}

    def count(self) -> int:
        """How many answers are kept, changed ones counted once."""
        with self._lock:
            return int(self._database.execute("SELECT count(*) FROM responses").fetchone()[0])


def _seconds(value: Any) -> float | None:
    with contextlib.suppress(TypeError, ValueError, OverflowError):
        seconds = float(value)
        return seconds if 0 <= seconds < 1e7 else None
    return None
