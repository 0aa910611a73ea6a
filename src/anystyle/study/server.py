"""A small local server for the form: the standard library's, one request a thread, answers through the store."""

import json
import logging
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from anystyle.study.form import picture_files, render
from anystyle.study.protocol import Study
from anystyle.study.store import Store

_log = logging.getLogger(__name__)
_LARGEST_MESSAGE = 64 * 1024


class StudyServer(ThreadingHTTPServer):
    """Serves one study's page and pictures, and takes in its answers.

    Args:
        study: The study.
        folder: Where its pictures are.
        store: Where answers go.
        host: The address to listen at; other machines reach the server only if it is not the local one.
        port: 0 takes a free one.
    """

    daemon_threads = True
    allow_reuse_address = True

    def __init__(self, *, study: Study, folder: Path, store: Store, host: str = "127.0.0.1", port: int = 8765) -> None:
        files = picture_files(study, folder)
        self.store = store
        self.pictures = {f"/pictures/{name}.jpg": file for name, file in files.items()}
        self.page = render(study, {name: f"pictures/{name}.jpg" for name in files}, server=True).encode()
        super().__init__((host, port), _Handler)

    @property
    def url(self) -> str:
        """Where the page is."""
        host, port = self.server_address[:2]
        return f"http://{host!s}:{port}/"


class _Handler(BaseHTTPRequestHandler):
    server_version = "anystyle-study"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = 60

    @property
    def _study(self) -> StudyServer:
        assert isinstance(self.server, StudyServer)
        return self.server

    def do_GET(self) -> None:
        """The page, a picture, or a participant's state."""
        url = urlsplit(self.path)
        if url.path == "/":
            self._reply(200, "text/html; charset=utf-8", self._study.page)
        elif url.path in self._study.pictures:
            self._reply(200, "image/jpeg", self._study.pictures[url.path].read_bytes(), "public, max-age=86400")
        elif url.path == "/state":
            participant = parse_qs(url.query).get("participant", [""])[0]
            state = self._study.store.state(participant)
            self._json(404 if state is None else 200, state or {"error": "no answers yet"})
        else:
            self._json(404, {"error": "there is nothing here"})

    def do_POST(self) -> None:
        """One answer: it is on the disk before the reply."""
        length = self.headers.get("Content-Length", "")
        if not length.isdigit() or int(length) > _LARGEST_MESSAGE:
            self.close_connection = True
            return self._json(413, {"error": "an answer of known and moderate length is expected"})
        body = self.rfile.read(int(length))
        # A page of another site can send plain forms here, but no JSON.
        if urlsplit(self.path).path != "/answers" or self.headers.get_content_type() != "application/json":
            return self._json(400, {"error": "an answer as JSON is expected at /answers"})
        try:
            message = json.loads(body)
            if not isinstance(message, dict):
                raise ValueError("an object is expected")
            self._study.store.add(message)
        except (ValueError, RecursionError) as error:
            return self._json(400, {"error": str(error)})
        return self._json(200, {"saved": True})

    def _json(self, status: int, content: dict[str, object]) -> None:
        self._reply(status, "application/json", json.dumps(content).encode())

    def _reply(self, status: int, kind: str, body: bytes, cache: str = "no-store") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Cache-Control", cache)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: object) -> None:
        """Requests go to the log, not to the terminal."""
        _log.debug(format, *args)


def serve(study: Study, folder: Path, database: Path, *, host: str, port: int, ready: Callable[[str], None]) -> None:
    """Serve until interrupted.

    Args:
        study: The study.
        folder: Where its pictures are.
        database: The SQLite file for the answers.
        host: The address to listen at.
        port: 0 takes a free one.
        ready: Told the page's address.

    Raises:
        ValueError: The database belongs to another study, or pictures are missing.
        OSError: The port is taken.
    """
    store = Store(study=study, path=database)
    with StudyServer(study=study, folder=folder, store=store, host=host, port=port) as server:
        ready(server.url)
        try:
            server.serve_forever()
        except KeyboardInterrupt:
            pass
        finally:
            server.server_close()
            store.close()
