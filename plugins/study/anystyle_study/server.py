"""The form as one page, with or without a server, and the server that stores its answers."""

import base64
import hashlib
import json
import logging
import sqlite3
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from html import escape
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import msgspec
from waitress.server import create_server

from anystyle.errors import UserError
from anystyle.io.atomic import atomic_path
from anystyle.io.documents import parse_json
from anystyle_study.protocol import PICTURES, Participant, Study
from anystyle_study.store import Claim, Fact, PostedAnswer, Refused, SessionMessage, Store

_log = logging.getLogger(__name__)
_JSON = "application/json"
_KINDS = {".jpg": "image/jpeg", ".mp4": "video/mp4"}
_SHOWN = ("title", "instructions", "consent", "demographics", "questions", "show", "frames_per_second", "id_parameters")
"""Fields of the plan that the page gets."""


def picture_files(study: Study, folder: Path) -> dict[str, Path]:
    """Files of all pictures and videos."""
    paths = {name: folder / PICTURES / name for name in study.pictures}
    missing = [name for name, file in paths.items() if not file.is_file()]
    if missing:
        raise UserError(f"{folder / PICTURES} lacks {len(missing)} pictures, such as {missing[0]}; design anew")
    return paths


def sequence(study: Study, participant: Participant) -> list[dict[str, Any]]:
    """The sets for a participant, in order; methods are not named, and checks look like any other set."""
    sets = []
    for name in participant.order:
        entry = study.shown[name]
        item = study.item(name)
        a, b = (entry.ours, entry.theirs) if name in participant.ours_is_a else (entry.theirs, entry.ours)
        about = {name: getattr(item, name) for name in ("content", "reference", "text")}
        sets.append({"id": name, "A": a, "B": b, **about})
    return sets


def render(study: Study, pictures: Mapping[str, str] | None = None) -> str:
    """The page; with ``pictures`` as data URLs it needs no server and holds the sets of every participant."""
    pages = files("anystyle_study") / "pages"
    page, style, script = ((pages / f"form.{name}").read_text(encoding="utf-8") for name in ("html", "css", "js"))
    plan = msgspec.to_builtins(study.plan)
    data = {"id": study.id, "server": pictures is None, **{name: plan[name] for name in _SHOWN}}
    if pictures is not None:
        data |= {"pictures": pictures, "people": {person.id: sequence(study, person) for person in study.participants}}
    # No text may look like the end of the script element.
    text = json.dumps(data, ensure_ascii=False).replace("<", "\\u003c").replace(">", "\\u003e")
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    title = escape(study.plan.title)
    return Template(page).substitute(title=title, style=style, data=text, script=script, hash=digest)


def write_page(study: Study, folder: Path, out: Path) -> None:
    """Write the page with all pictures in it, as one file that works offline."""
    pictures = {
        name: f"data:{_KINDS[file.suffix]};base64,{base64.b64encode(file.read_bytes()).decode()}"
        for name, file in picture_files(study, folder).items()
    }
    page = render(study, pictures)
    with atomic_path(out) as path:
        path.write_text(page, encoding="utf-8")


class StudyApplication:
    """The WSGI application of one study: its page, its pictures, and the answers posted to it."""

    def __init__(self, *, study: Study, folder: Path, store: Store) -> None:
        self._study, self._store = study, store
        self._pictures = {f"/pictures/{name}": file for name, file in picture_files(study, folder).items()}
        self._page = render(study).encode()
        self._handlers: dict[str, tuple[type, Callable[[Any, str], Any]]] = {
            "/session": (Claim, self._begin),
            "/answers": (PostedAnswer, store.add),
            "/facts": (Fact, store.note),
            "/finish": (SessionMessage, store.finish),
        }

    def __call__(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        """Answer one request."""
        status, kind, body = self._answer(environ["PATH_INFO"], environ)
        headers = [
            ("Content-Type", kind),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store" if kind == _JSON else "private, max-age=3600"),
            ("X-Content-Type-Options", "nosniff"),
            ("Referrer-Policy", "no-referrer"),
        ]
        start_response(f"{status} {HTTPStatus(status).phrase}", headers)
        return [body]

    def _answer(self, path: str, environ: dict[str, Any]) -> tuple[int, str, bytes]:
        if environ["REQUEST_METHOD"] == "GET":
            if path == "/":
                return 200, "text/html; charset=utf-8", self._page
            if path in self._pictures:
                return 200, _KINDS[self._pictures[path].suffix], self._pictures[path].read_bytes()
            return _error(404, "there is nothing here")
        try:
            # Pages of other sites can send plain forms here, but not JSON.
            if environ.get("CONTENT_TYPE", "").partition(";")[0].strip() != _JSON:
                return _error(400, "JSON is expected")
            if path not in self._handlers:
                return _error(404, "there is nothing here")
            kind, handle = self._handlers[path]
            message = parse_json(environ["wsgi.input"].read(), kind, source="the message")
            token = environ.get("HTTP_AUTHORIZATION", "").removeprefix("Bearer ")
            return 200, _JSON, json.dumps(handle(message, token) or {"saved": True}).encode()
        except (Refused, UserError) as error:
            return _error(error.status if isinstance(error, Refused) else 400, error)
        except (sqlite3.Error, OSError) as error:
            _log.error("answers cannot be stored: %s", error)
            return _error(503, "answers cannot be stored at the moment")

    def _begin(self, message: Claim, _: str) -> dict[str, Any]:
        session = self._store.claim(message)
        participant = self._study.participant(session["participant"])
        assert participant is not None
        return session | {"sets": sequence(self._study, participant)}


def _error(status: int, reason: object) -> tuple[int, str, bytes]:
    return status, _JSON, json.dumps({"error": str(reason)}).encode()


def serve(study: Study, folder: Path, database: Path, *, host: str, port: int, ready: Callable[[str], None]) -> None:
    """Serve until interrupted; ``ready`` is called with the page's address.

    Requests are read whole before a thread answers them, so that slow and idle clients occupy none.
    """
    with closing(Store(study=study, path=database)) as store:
        server: Any = create_server(
            StudyApplication(study=study, folder=folder, store=store),
            host=host,
            port=port,
            ipv6=":" in host,
            ident="anystyle-study",
            threads=8,
            max_request_body_size=64 * 1024,
            connection_limit=900,
            channel_timeout=15,
            cleanup_interval=5,
            asyncore_use_poll=True,
        )
        ready(f"http://{server.effective_host}:{server.effective_port}/")
        server.run()
        server.close()
