"""The start page's server: one person's browser on this machine asks, in JSON; all else is refused."""

import json
import logging
import mimetypes
import re
import secrets
import sys
import threading
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack
from http import HTTPStatus
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any
from urllib.parse import parse_qsl, quote
from wsgiref.util import FileWrapper

from waitress.server import create_server
from waitress.wasyncore import close_all

from anystyle.errors import UserError, one_line
from anystyle.io.atomic import folder_lock
from anystyle_start.actions import Actions
from anystyle_start.uploads import PART
from anystyle_viewer.server import LOOPBACK, MAX_UPLOAD, refusal

_log = logging.getLogger(__name__)
_JSON, _HTML = "application/json", "text/html; charset=utf-8"
_PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; media-src 'self' blob:; "
    "connect-src 'self'; frame-src 'self' http://127.0.0.1:*; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
_SCENE_POLICY = "sandbox allow-scripts allow-downloads; frame-ancestors 'self'"
"""Of the page of a scene: it runs by itself, and can ask this server for nothing."""

Reply = tuple[int, dict[str, str], bytes | Path]
"""Status, headers, and a body or a file of it."""


class Application:
    """The WSGI application; ``actions`` answer what is asked."""

    def __init__(self, actions: Actions) -> None:
        self.actions, self.token = actions, secrets.token_urlsafe(24)
        pages = files("anystyle_start") / "pages"

        def text(name: str) -> str:
            return (pages / name).read_text(encoding="utf-8")

        self._static = {
            "/": (_HTML, Template(text("start.html")).substitute(token=self.token)),
            "/start.css": ("text/css; charset=utf-8", text("start.css")),
            **{f"/{name}": ("text/javascript; charset=utf-8", text(name)) for name in ("start.js", "masks.js")},
        }

    def __call__(self, environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        """Answer one request."""
        status, headers, body = self._answer(environ)
        headers = {
            "Cache-Control": "no-store",
            "X-Content-Type-Options": "nosniff",
            "Referrer-Policy": "no-referrer",
            "Cross-Origin-Resource-Policy": "same-origin",
            **headers,
        }
        content: Iterable[bytes] = [body] if isinstance(body, bytes) else []
        if isinstance(body, Path):
            status, extra, content = _file(body, environ)
            headers |= extra
        else:
            headers["Content-Length"] = str(len(body))
        start_response(f"{status} {HTTPStatus(status).phrase}", list(headers.items()))
        return content

    def _answer(self, environ: dict[str, Any]) -> Reply:
        path, method = environ["PATH_INFO"], environ["REQUEST_METHOD"]
        status = refusal(environ.get("HTTP_HOST", ""), environ.get("HTTP_ORIGIN"), changes=method != "GET")
        elsewhere = environ.get("HTTP_SEC_FETCH_SITE", "none") not in ("same-origin", "none") and path != "/"
        guessed = not secrets.compare_digest(environ.get("HTTP_X_ANYSTYLE_TOKEN", ""), self.token)
        if not status and (elsewhere or (method == "POST" and guessed)):
            status = 403
        if not status and method not in ("GET", "POST"):
            status = 405
        if status:
            return _error(status, "this request is not from the page of this program; load the page again")
        try:
            query = dict(parse_qsl(environ.get("QUERY_STRING", "")))
            if method == "GET":
                return self._get(path, query)
            return _json(200, self.actions.post(path.split("/")[1:], query, environ["wsgi.input"]))
        except UserError as error:
            return _error(400, one_line(error))
        except OSError as error:
            _log.error("%s cannot be answered: %s", path, error)
            return _error(503, one_line(error.strerror or error))

    def _get(self, path: str, query: Mapping[str, str]) -> Reply:
        if path in self._static:
            kind, body = self._static[path]
            return 200, {"Content-Type": kind, "Content-Security-Policy": _PAGE_POLICY}, body.encode()
        first, *rest = path.strip("/").split("/")
        if first == "choices":
            return _json(200, self.actions.choices)
        if first == "state":
            return _json(200, self.actions.state(query.get("scene", "")))
        file = self.actions.file(first, rest)
        if file is None:
            return _error(404, "there is nothing here")
        headers = {"Content-Type": mimetypes.guess_type(file.name)[0] or "application/octet-stream"}
        if file.suffix == ".html":
            headers |= {"Content-Type": _HTML, "Content-Security-Policy": _SCENE_POLICY}
        elif file.suffix in (".txt", ".log"):
            headers["Content-Type"] = "text/plain; charset=utf-8"
        elif file.suffix in (".jpg", ".png"):
            headers["Cache-Control"] = "private, max-age=3600"
        if name := query.get("name"):
            headers["Content-Disposition"] = f"attachment; filename*=UTF-8''{quote(name[:120], safe='')}"
        return 200, headers, file


def _json(status: int, value: object) -> Reply:
    return status, {"Content-Type": _JSON}, json.dumps(value, ensure_ascii=False).encode()


def _error(status: int, reason: str) -> Reply:
    return _json(status, {"error": reason})


def _file(path: Path, environ: Mapping[str, Any]) -> tuple[int, dict[str, str], Iterable[bytes]]:
    """A file, or the range of it that is asked for: players of films seek."""
    size = path.stat().st_size
    ranged = re.fullmatch(r"bytes=(\d+)-(\d*)", environ.get("HTTP_RANGE", ""))
    file = path.open("rb")
    if ranged and int(ranged[1]) < size:
        first, last = int(ranged[1]), int(ranged[2] or size - 1)
        with file:
            file.seek(first)
            content = file.read(max(0, min(last + 1 - first, PART)))
        end = first + len(content) - 1
        headers = {"Content-Range": f"bytes {first}-{end}/{size}", "Content-Length": str(len(content))}
        return 206, headers, [content]
    wrapper = environ.get("wsgi.file_wrapper", FileWrapper)
    return 200, {"Content-Length": str(size), "Accept-Ranges": "bytes"}, wrapper(file, 1 << 16)


class StartServer(AbstractContextManager["StartServer"]):
    """The running start page; as a context manager it ends its work at the end.

    Args:
        folder: Where scenes are stored; one program at a time uses it.
        port: 0 takes a free one.
        program: The words that start ``anystyle``.
    """

    def __init__(
        self, folder: Path, port: int = 0, program: Sequence[str] = (sys.executable, "-m", "anystyle")
    ) -> None:
        with ExitStack() as stack:
            refused = f"another start page keeps its scenes in {folder}; use that one, or name a folder with --keep"
            stack.enter_context(folder_lock(folder, refused))
            actions = stack.enter_context(Actions(folder.absolute(), program))
            self.application = Application(actions)
            self._sockets: dict[int, Any] = {}
            try:
                self._server: Any = create_server(
                    self.application,
                    map=self._sockets,
                    host=LOOPBACK[0],
                    port=port,
                    ident="anystyle",
                    threads=8,
                    max_request_body_size=max(MAX_UPLOAD, PART) + 1,
                    inbuf_overflow=1 << 20,
                    clear_untrusted_proxy_headers=True,
                )
            except OSError as error:
                raise UserError(f"port {port} cannot be used ({error.strerror}); give another with --port") from None
            self._thread = threading.Thread(target=self._server.run, daemon=True)
            self._thread.start()
            self._stack = stack.pop_all()

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{self._server.effective_host}:{self._server.effective_port}/"

    def __exit__(self, *_: object) -> None:
        # Workers wake the server's thread too, at any moment: its sockets and its pipe stay open until it has ended.
        still_open: dict[int, Any] = {}
        self._server.trigger.pull_trigger(lambda: (still_open.update(self._sockets), self._sockets.clear()))
        self._thread.join(timeout=10)
        for channel in self._server.active_channels.copy().values():
            channel.handle_close()  # wakes a worker that waits for its reader
        self._server.task_dispatcher.shutdown()
        close_all(still_open)
        self._stack.close()
