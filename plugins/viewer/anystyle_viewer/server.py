"""The HTTP server of the viewer, at a loopback address: its page, what is posted to it, and a proxy of viser.

Web pages from elsewhere that a browser of this machine shows can send requests here, too, by forged posts or DNS
rebinding, so the ``Host`` and ``Origin`` headers of every request are checked.
"""

import socket
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, BinaryIO
from urllib.parse import parse_qsl, urlsplit

from anystyle.errors import UserError, one_line

LOOPBACK = ("127.0.0.1", "localhost", "::1")

OnPost = Callable[[Mapping[str, str], bytes], None]
"""Handles a request, given its query and its body; a ``UserError`` is answered as one line."""


class PageServer(ThreadingHTTPServer):
    """Serves ``page`` at ``/``, handlers of POST requests by path, and viser's server at all other paths.

    It runs on threads of its own until :meth:`close`; ``port`` 0 takes a free one.
    """

    daemon_threads = True

    def __init__(
        self, *, port: int, viser_port: int, page: bytes, on_post: Mapping[str, OnPost], max_body: int
    ) -> None:
        self.viser_port, self.page, self.on_post, self.max_body = viser_port, page, on_post, max_body
        try:
            super().__init__((LOOPBACK[0], port), _Handler)
        except OSError as error:
            raise UserError(f"port {port} cannot be used ({error.strerror}); give another with --port") from None
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{LOOPBACK[0]}:{self.server_port}/"

    def close(self) -> None:
        """Stop serving."""
        self.shutdown()
        self.server_close()


class _Handler(BaseHTTPRequestHandler):
    server: PageServer  # pyright: ignore[reportIncompatibleVariableOverride]
    protocol_version = "HTTP/1.1"
    timeout = 60

    def log_message(self, format: str, *args: Any) -> None:
        """Print nothing."""

    def _refused(self) -> bool:
        """Whether a request comes from another site, which is then answered."""
        host, origin = self.headers.get("Host", ""), self.headers.get("Origin")
        local = urlsplit(f"//{host}").hostname in LOOPBACK
        own = self.command != "POST" if origin is None else urlsplit(origin).netloc == host
        if not (local and own):
            self._answer(403 if local else 421, "this request is not from the viewer's page on this machine")
        return not (local and own)

    def _answer(self, status: int, body: str | bytes, kind: str = "text/plain") -> None:
        content = body.encode() if isinstance(body, str) else body
        self.send_response(status)
        self.send_header("Content-Type", f"{kind}; charset=utf-8")
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(content)

    def do_POST(self) -> None:
        if self._refused():
            return
        address, length = urlsplit(self.path), self.headers.get("Content-Length", "")
        handler = self.server.on_post.get(address.path)
        if handler is None:
            self._answer(404, "nothing is accepted at this path")
        elif not length.isdecimal() or int(length) > self.server.max_body:
            self._answer(413, f"at most {self.server.max_body:,} bytes are accepted")
        else:
            try:
                handler(dict(parse_qsl(address.query)), self.rfile.read(int(length)))
            except (UserError, OSError) as error:
                self._answer(400, one_line(error))
            else:
                self._answer(200, "")

    def do_GET(self) -> None:
        if self._refused():
            return
        if "Upgrade" not in self.headers:
            if urlsplit(self.path).path == "/":
                self._answer(200, self.server.page, "text/html")
                return
            del self.headers["Connection"]
            self.headers["Connection"] = "close"  # so that the next request is checked, too
        self.close_connection = True
        self.connection.settimeout(None)
        with suppress(OSError), socket.create_connection((LOOPBACK[0], self.server.viser_port)) as viser:
            lines = [self.requestline, *(f"{name}: {value}" for name, value in self.headers.items())]
            viser.sendall("\r\n".join([*lines, "", ""]).encode("latin-1"))
            threading.Thread(target=_copy, args=(self.rfile, viser), daemon=True).start()
            with viser.makefile("rb") as replies:
                _copy(replies, self.connection)


def _copy(source: BinaryIO, target: socket.socket) -> None:
    """Forward bytes until one end closes."""
    with suppress(OSError, ValueError):
        while data := source.read1(1 << 16):  # pyright: ignore[reportAttributeAccessIssue]
            target.sendall(data)
        target.shutdown(socket.SHUT_WR)
