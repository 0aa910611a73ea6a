"""viser's page with a few additions (dropped images, a row of styles, the line of a split view), and its server."""

import hashlib
import re
import socket
import sys
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from html import escape
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import parse_qsl, urlsplit

from anystyle.data.images import open_image
from anystyle.errors import UserError, one_line
from anystyle.paths import distinct

MAX_UPLOAD = 32 * 1024 * 1024
"""Bytes of an uploaded image."""
MAX_SIDE = 2048
"""Pixels; the longer side of larger images is reduced to less than twice of it."""


def page(viser_page: Path) -> bytes:
    """The HTML page of viser with the script and style sheet of this package."""
    folder = files("anystyle_viewer")
    script, css = (folder.joinpath(f"page.{suffix}").read_text(encoding="utf-8") for suffix in ("js", "css"))
    script = script.replace("$largest", str(MAX_UPLOAD))
    head = f"<title>anystyle</title>\n<script>\n{script}</script>\n<style>\n{css}</style>\n"
    return viser_page.read_text(encoding="utf-8").replace("<title>Viser</title>", head).encode()


def style_row(styles: Sequence[str], current: str, thumbnails: Mapping[str, str]) -> str:
    """Buttons for styles, as HTML; ``thumbnails`` are URLs of images by style."""
    buttons = ""
    for style in styles:
        image = f'<img alt="" src="{thumbnails[style]}">' if style in thumbnails else "<i></i>"
        title, pressed = escape(title_of(style) or "unstyled"), str(style == current).lower()
        attributes = f'data-style="{escape(style)}" aria-pressed="{pressed}" title="{title}"'
        buttons += f'<button type="button" {attributes}>{image}<span>{title}</span></button>'
    return f'<div class="anystyle-row">{buttons}</div>'


def title_of(style: str) -> str:
    """A style as a title; the file of an uploaded image loses its path, suffix and hash."""
    return re.sub(r"(-[0-9a-f]{8})?\.png$", "", Path(style).name) if style.endswith(".png") else style[:60]


def store_upload(folder: Path, name: str, content: bytes) -> Path:
    """Store an uploaded image as PNG under its name and the first digits of its hash; a UserError refuses it."""
    if len(content) > MAX_UPLOAD:
        raise UserError(f"an image of {len(content):,} bytes; at most {MAX_UPLOAD:,} are accepted")
    stem = "".join(letter if letter.isalnum() else "-" for letter in Path(name).stem)[:40] or "image"
    image = open_image(content, f"the image {stem}", longest=MAX_SIDE, masked=True)
    folder.mkdir(parents=True, exist_ok=True)
    digest, kept = hashlib.sha256(content).hexdigest()[:8], [title_of(file.name) for file in folder.glob("*.png")]
    same = next((f for f in folder.glob(f"*-{digest}.png") if re.fullmatch(rf"{stem}(-\d+)?", title_of(f.name))), None)
    target = same or folder / f"{distinct([*kept, stem], '-')[-1]}-{digest}.png"
    image.save(target)
    return target


LOOPBACK = ("127.0.0.1", "localhost", "::1")


def refusal(host: str, origin: str | None, *, changes: bool) -> int | None:
    """The status that refuses a request from elsewhere, or ``None``.

    Web pages from elsewhere that a browser of this machine shows can send requests here, too, by forged posts or DNS
    rebinding; browsers always name the origin of a request that changes something.
    """
    try:
        name = urlsplit(f"//{host}").hostname
    except ValueError:
        name = None
    if name not in LOOPBACK:
        return 421
    own = not changes if origin is None else urlsplit(origin).netloc == host
    return None if own else 403


OnPost = Callable[[Mapping[str, str], bytes], None]
"""Handles a request, given its query and its body; a ``UserError`` is answered as one line."""


class PageServer(ThreadingHTTPServer):
    """Serves ``page`` at ``/``, handlers of POST requests by path, and viser's server at all other paths.

    It runs on threads of its own until :meth:`close`; ``port`` 0 takes a free one. Every request is checked by
    :func:`refusal`.
    """

    daemon_threads = True

    def __init__(
        self, *, port: int, viser_port: int, page: bytes, on_post: Mapping[str, OnPost], max_body: int
    ) -> None:
        self.viser_port, self.page, self.on_post, self.max_body = viser_port, page, on_post, max_body
        try:
            super().__init__((LOOPBACK[0], port), _Handler)
        except (OSError, OverflowError) as error:
            why = getattr(error, "strerror", error)
            raise UserError(f"port {port} cannot be used ({why}); give another with --port") from None
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://{LOOPBACK[0]}:{self.server_port}/"

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # a browser that has gone is no error
            super().handle_error(request, client_address)

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
        status = refusal(self.headers.get("Host", ""), self.headers.get("Origin"), changes=self.command == "POST")
        if status is not None:
            self._answer(status, "this request is not from the viewer's page on this machine")
        return status is not None

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
        elif len(body := self.rfile.read(int(length))) == int(length):  # else the browser has gone
            try:
                handler(dict(parse_qsl(address.query)), body)
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
