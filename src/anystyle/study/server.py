"""The form, one page with or without a server, and the server that keeps its answers."""

import base64
import hashlib
import json
import logging
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from html import escape
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import msgspec
from waitress.server import create_server

from anystyle.documents import parse_json
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.study.protocol import PICTURES, Check, Participant, Study
from anystyle.study.store import Answer, Claim, Fact, Message, Refused, Store

_SHOWN = ("title", "instructions", "consent", "demographics", "questions", "show", "frames_per_second", "id_parameters")
"""What of a plan the page knows."""


def picture_files(study: Study, folder: Path) -> dict[str, Path]:
    """The file of every picture and video.

    Raises:
        ValueError: One is missing.
    """
    paths = {name: folder / PICTURES / name for name in study.pictures}
    missing = [name for name, file in paths.items() if not file.is_file()]
    if missing:
        raise ValueError(f"{folder / PICTURES} lacks {len(missing)} pictures, such as {missing[0]}; design anew")
    return paths


def sequence(study: Study, participant: Participant) -> list[dict[str, Any]]:
    """What a participant sees, in order: no method is named, and a check looks like any other set."""
    sets = []
    for name in participant.order:
        entry = study.shown[name]
        item = study.shown[entry.of] if isinstance(entry, Check) else entry
        assert not isinstance(item, Check)
        ours_is_a = name in participant.ours_is_a
        sets.append(
            {
                "id": name,
                "A": entry.ours if ours_is_a else entry.theirs,
                "B": entry.theirs if ours_is_a else entry.ours,
                "content": item.content,
                "reference": item.reference,
                "text": item.text,
            }
        )
    return sets


def render(study: Study, pictures: Mapping[str, str] | None = None) -> str:
    """The page; with ``pictures`` as data URLs it needs no server, and holds what every participant sees."""
    pages = files("anystyle.study") / "pages"
    script = (pages / "form.js").read_text(encoding="utf-8")
    plan = msgspec.to_builtins(study.plan)
    data = {"id": study.id, "server": pictures is None, **{name: plan[name] for name in _SHOWN}}
    if pictures is not None:
        data |= {"pictures": pictures, "people": {person.id: sequence(study, person) for person in study.participants}}
    text = json.dumps(data, ensure_ascii=False)
    return Template((pages / "form.html").read_text(encoding="utf-8")).substitute(
        title=escape(study.plan.title),
        style=(pages / "form.css").read_text(encoding="utf-8"),
        # Inside a script element, no text may look like its end.
        data=text.replace("<", "\\u003c").replace(">", "\\u003e").replace("\u2028", "\\u2028"),
        script=script,
        hash=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def write_page(study: Study, folder: Path, out: Path) -> None:
    """Write the page with every picture inside it: one file that works offline.

    Raises:
        ValueError: A picture is missing.
    """
    kinds = {".jpg": "image/jpeg", ".mp4": "video/mp4"}
    pictures = {
        name: f"data:{kinds[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"
        for name, file in picture_files(study, folder).items()
    }
    page = render(study, pictures)
    with atomic_path(out) as path:
        path.write_text(page, encoding="utf-8")


_log = logging.getLogger(__name__)
_LARGEST_MESSAGE = 64 * 1024
_KINDS = {".jpg": "image/jpeg", ".mp4": "video/mp4"}


class Application:
    """The WSGI application of one study: its page, its pictures, and what comes in."""

    def __init__(self, *, study: Study, folder: Path, store: Store) -> None:
        self._study, self._store = study, store
        self._pictures = {f"/pictures/{name}": file for name, file in picture_files(study, folder).items()}
        self._page = render(study).encode()

    def __call__(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        """Answer one request."""
        status, kind, body = self._answer(environ)
        headers = [
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store" if kind == "application/json" else "private, max-age=3600"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
        ]
        start_response(f"{status} {HTTPStatus(status).phrase}", headers)
        return [body]

    def _answer(self, environ: dict[str, Any]) -> tuple[int, str, bytes]:
        path = environ["PATH_INFO"]
        if environ["REQUEST_METHOD"] == "GET":
            if path == "/":
                return 200, "text/html; charset=utf-8", self._page
            if path in self._pictures:
                return 200, _KINDS[self._pictures[path].suffix], self._pictures[path].read_bytes()
            return _json(404, {"error": "there is nothing here"})
        try:
            return _json(200, self._take(path, environ))
        except Refused as error:
            return _json(error.status, {"error": str(error)})
        except UserError as error:
            return _json(400, {"error": str(error)})
        except (sqlite3.Error, OSError) as error:
            _log.error("nothing can be kept: %s", error)
            return _json(503, {"error": "nothing can be kept at the moment"})

    def _take(self, path: str, environ: dict[str, Any]) -> dict[str, Any]:
        # A page of another site can send plain forms here, but no JSON.
        if environ.get("CONTENT_TYPE", "").partition(";")[0].strip() != "application/json":
            raise Refused(400, "JSON is expected")
        body = environ["wsgi.input"].read()
        token = environ.get("HTTP_AUTHORIZATION", "").removeprefix("Bearer ")
        if path == "/session":
            session = self._store.claim(parse_json(body, Claim, source="the message"))
            participant = self._study.participant(session["participant"])
            assert participant is not None
            return session | {"sets": sequence(self._study, participant)}
        if path == "/answers":
            self._store.add(parse_json(body, Answer, source="the message"), token)
        elif path == "/facts":
            self._store.note(parse_json(body, Fact, source="the message"), token)
        elif path == "/finish":
            return self._store.finish(parse_json(body, Message, source="the message"), token)
        else:
            raise Refused(404, "there is nothing here")
        return {"saved": True}


def _json(status: int, content: dict[str, Any]) -> tuple[int, str, bytes]:
    return status, "application/json", json.dumps(content).encode()


def serve(
    study: Study,
    folder: Path,
    database: Path,
    *,
    host: str,
    port: int,
    ready: Callable[[str], None],
    connections: int = 900,
    patience: int = 15,
) -> None:
    """Serve until interrupted.

    Requests are read whole before one of a few threads answers them, so that slow and idle clients hold none.

    Args:
        study: The study.
        folder: Where its pictures are.
        database: The SQLite file for the answers.
        host: The address to listen at; other machines reach the server only if it is not the local one.
        port: 0 takes a free one.
        ready: Told the page's address.
        connections: At a time; more wait.
        patience: Seconds after which an idle connection is closed.

    Raises:
        ValueError: The database belongs to another study, or pictures are missing.
        OSError: The port is taken.
    """
    store = Store(study=study, path=database)
    try:
        server: Any = create_server(
            Application(study=study, folder=folder, store=store),
            host=host,
            port=port,
            ipv6=":" in host,
            ident="anystyle-study",
            threads=8,
            connection_limit=connections,
            channel_timeout=patience,
            cleanup_interval=max(1, patience // 3),
            max_request_body_size=_LARGEST_MESSAGE,
            max_request_header_size=16 * 1024,
            asyncore_use_poll=True,
        )
        ready(f"http://{server.effective_host}:{server.effective_port}/")
        server.run()
        server.close()
    finally:
        store.close()
