"""A served study for the tests: its process, its messages, and what it kept."""

import json
import os
import re
import signal
import sqlite3
import subprocess
import sys
import urllib.error
import urllib.request
from contextlib import closing, contextmanager
from pathlib import Path

PATIENCE = 120
"""Seconds after which a process hangs; a busy machine takes long for an answer."""


@contextmanager
def serving(folder: Path, database: Path, port: int = 0):
    """``anystyle study form --serve`` in a process of its own; the address that it printed."""
    command = [sys.executable, "-m", "anystyle", "study", "form", str(folder), "--serve"]
    command += ["--port", str(port), "--database", str(database)]
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[1]), os.environ.get("PYTHONPATH")]))
    process = subprocess.Popen(
        command,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A suite in the background ignores interrupts, and so would what it starts.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        env={**os.environ, "PYTHONPATH": path},
    )
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        address = re.search(r"http://[\d.]+:(\d+)/", line)
        assert address, line + (process.stderr.read() if process.stderr else "")
        yield process, address[0], int(address[1])
    finally:
        process.kill()
        process.communicate()


def token_of(person: str) -> str:
    """The secret of a person's browser."""
    return person.encode().hex().ljust(32, "0")[:32]


def post(url: str, path: str, message: object, token: str = "", kind: str = "application/json") -> tuple[int, dict]:
    """Send a message as the page does."""
    body = message if isinstance(message, bytes) else json.dumps(message).encode()
    headers = {"Content-Type": kind, "Authorization": f"Bearer {token}"}
    request = urllib.request.Request(url + path, body, headers)
    try:
        with urllib.request.urlopen(request, timeout=PATIENCE) as reply:
            return reply.status, json.loads(reply.read())
    except urllib.error.HTTPError as error:
        with error:
            text = error.read().decode()
            return error.code, json.loads(text) if text.startswith("{") else {"error": text}


def claim(url: str, study, person: str) -> tuple[int, dict]:
    """Begin or resume a session."""
    return post(url, "session", {"study": study.id, "person": person, "token": token_of(person)})


def answer(study, participant, item, question="style", score=2, side="", **changes) -> dict:
    """An answer as the page sends it."""
    return {
        "study": study.id,
        "participant": participant,
        "item": item,
        "question": question,
        "side": side,
        "score": score,
        "seconds": 1.5,
        "time": "2026-01-01T00:00:00Z",
        "revision": 1,
        **changes,
    }


def kept_answers(database: Path, participant: str) -> dict[tuple[str, str, str], int]:
    """The scores that the view ``responses`` holds."""
    with closing(sqlite3.connect(database)) as connection:
        query = "SELECT item, question, side, score FROM responses WHERE participant = ?"
        return {tuple(row[:3]): row[3] for row in connection.execute(query, (participant,))}
