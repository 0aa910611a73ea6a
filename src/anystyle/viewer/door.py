"""What stands before the viewer's server: it lets nobody in from elsewhere, and nothing larger than a picture.

The viewer itself listens at a free port of this machine alone and knows no secrets. A web page of somebody else that
this machine's browser shows could still reach it; the door compares names and, where it is opened to a network, asks
for a token.
"""

import asyncio
import contextlib
import hmac
import secrets
import threading
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple
from urllib.parse import parse_qs, urlsplit

from anystyle.errors import one_line

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MAX_HEAD, HEAD_SECONDS = 16 * 1024, 10.0
MAX_CONNECTIONS = 64
MAX_UPLOAD, UPLOAD_SECONDS = 64 * 1024 * 1024, 60.0
"""More bytes than this in so many seconds end a connection."""
COOKIE = "anystyle_view"

Answer = Callable[[Mapping[str, str], bytes], None]
"""Does what a request asks for, given its query and its body.

Raises:
    ValueError: With a line for whoever asked.
"""


class Door:
    """Forwards connections to a server of this machine, once their first request is judged.

    Args:
        target: The port of the server behind it.
        host: The address to listen at.
        port: 0 takes a free one.
        token: What the first request must know, in its query or as a cookie; ``None`` at a loopback address.
        page: What ``/`` shows, as HTML; ``None`` leaves it to the server behind.
        answers: What may be posted, by path.
        largest: Bytes that may be posted.

    Raises:
        ValueError: The address is not loopback and there is no token.
        OSError: The address or the port cannot be had.
    """

    def __init__(
        self,
        *,
        target: int,
        host: str = LOOPBACK[0],
        port: int = 0,
        token: str | None = None,
        page: bytes | None = None,
        answers: Mapping[str, Answer] | None = None,
        largest: int = MAX_UPLOAD,
    ) -> None:
        if host not in LOOPBACK and token is None:
            raise ValueError(f"a door at {host} needs a token; only this machine is let in without")
        self.target, self.host, self.port, self.token = target, host, port, token
        self._page, self._answers, self._largest = page, dict(answers or {}), largest
        self._connections = 0
        self._loop = asyncio.new_event_loop()
        server = asyncio.start_server(self._open, host, port, limit=MAX_HEAD)
        self._server = self._loop.run_until_complete(server)
        self.port = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()

    @property
    def url(self) -> str:
        """Where people go, token included."""
        name = f"[{self.host}]" if ":" in self.host else self.host
        return f"http://{name}:{self.port}/" + (f"?token={self.token}" if self.token else "")

    def close(self) -> None:
        """Let nobody in any more, and end what is under way."""
        asyncio.run_coroutine_threadsafe(self._end(), self._loop).result(timeout=10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(timeout=10)
        self._loop.close()

    async def _end(self) -> None:
        self._server.close()
        tasks = asyncio.all_tasks() - {asyncio.current_task()}
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _open(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._connections += 1
        try:
            if self._connections > MAX_CONNECTIONS:
                return await _answer(writer, "503 Service Unavailable", b"too many connections")
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_SECONDS)
            refusal, extra = judged(head, self.token)
            if refusal:
                return await _answer(writer, refusal, refusal.partition(" ")[2].encode(), extra)
            request = read_head(head)
            if request.method == "POST":
                return await _answer(writer, *await self._posted(request, reader))
            if self._page is not None and request.path == "/" and "upgrade" not in request.headers:
                return await _answer(writer, "200 OK", self._page, kind="text/html")
            inner, outer = await asyncio.open_connection(LOOPBACK[0], self.target)
            outer.write(head)
            await asyncio.gather(_pipe(reader, outer, limited=True), _pipe(inner, writer))
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
            return None
        finally:
            self._connections -= 1
            writer.close()

    async def _posted(self, request: "Request", reader: asyncio.StreamReader) -> tuple[str, bytes]:
        """Status and text for what is posted."""
        answer, length = self._answers.get(request.path), request.headers.get("content-length", "")
        if answer is None:
            return "404 Not Found", b"nothing is taken here"
        if not length.isdecimal() or int(length) > self._largest:
            return "413 Content Too Large", f"at most {self._largest:,} bytes are taken".encode()
        body = await asyncio.wait_for(reader.readexactly(int(length)), UPLOAD_SECONDS)
        try:
            await self._loop.run_in_executor(None, answer, request.query, body)
        except (ValueError, OSError) as error:
            return "400 Bad Request", one_line(error).encode()
        return "200 OK", b""


class Request(NamedTuple):
    """The head of a request; names of headers are in lower case."""

    method: str
    path: str
    query: dict[str, str]
    headers: dict[str, str]


def read_head(head: bytes) -> Request:
    """What a request says; its method is empty where it is none."""
    first, *rest = head.decode("latin-1").split("\r\n")
    headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
    method, _, target = first.removesuffix(f" {first.rpartition(' ')[2]}").partition(" ")
    address = urlsplit(target)
    query = {name: values[0] for name, values in parse_qs(address.query).items()}
    return Request(method if first.count(" ") == 2 else "", address.path, query, headers)


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(16)


def judged(head: bytes, token: str | None) -> tuple[str, str]:
    """A status and headers to answer a first request with; an empty status lets it in.

    Args:
        head: Request line and headers.
        token: What it must know; ``None`` where it must be addressed to this machine instead.
    """
    request = read_head(head)
    if request.method not in ("GET", "HEAD", "POST"):
        return "405 Method Not Allowed", ""
    host = request.headers.get("host", "")
    if token is None and urlsplit(f"//{host}").hostname not in LOOPBACK:
        return "421 Misdirected Request", ""  # a name of somebody else's that leads here
    origin = request.headers.get("origin")
    if urlsplit(origin).netloc != host if origin is not None else request.method == "POST":
        return "403 Forbidden", ""  # a page of somebody else's; browsers say where a post comes from
    if token is None:
        return "", ""
    given = request.query.get("token", "")
    pairs = (pair.strip().partition("=") for pair in request.headers.get("cookie", "").split(";"))
    cookies = {name: value for name, _, value in pairs}
    if hmac.compare_digest(cookies.get(COOKIE, "").encode(), token.encode()):
        return "", ""
    if hmac.compare_digest(given.encode(), token.encode()):
        cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict"
        return "303 See Other", f"Location: /\r\nSet-Cookie: {cookie}\r\n"
    return "403 Forbidden", ""


async def _answer(
    writer: asyncio.StreamWriter, status: str, body: bytes, extra: str = "", kind: str = "text/plain"
) -> None:
    head = f"HTTP/1.1 {status}\r\n{extra}Content-Type: {kind}; charset=utf-8\r\nContent-Length: {len(body)}\r\n"
    head += "Cache-Control: no-store\r\nX-Content-Type-Options: nosniff\r\n"
    writer.write(f"{head}Connection: close\r\n\r\n".encode() + body)
    await writer.drain()


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter, *, limited: bool = False) -> None:
    """Pass bytes on until they end, or come faster than pictures do."""
    since, amount = time.monotonic(), 0
    with contextlib.suppress(OSError):
        while part := await reader.read(1 << 16):
            if time.monotonic() - since > UPLOAD_SECONDS:
                since, amount = time.monotonic(), 0
            amount += len(part)
            if limited and amount > MAX_UPLOAD:
                break
            writer.write(part)
            await writer.drain()
    writer.close()
