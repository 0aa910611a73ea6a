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
from urllib.parse import parse_qs, urlsplit

LOOPBACK = ("127.0.0.1", "localhost", "::1")
MAX_HEAD, HEAD_SECONDS = 16 * 1024, 10.0
MAX_CONNECTIONS = 64
MAX_UPLOAD, UPLOAD_SECONDS = 64 * 1024 * 1024, 60.0
"""More bytes than this in so many seconds end a connection."""
COOKIE = "anystyle_view"


class Door:
    """Forwards connections to a server of this machine, once their first request is judged.

    Args:
        target: The port of the server behind it.
        host: The address to listen at.
        port: 0 takes a free one.
        token: What the first request must know, in its query or as a cookie; ``None`` at a loopback address.

    Raises:
        ValueError: The address is not loopback and there is no token.
        OSError: The address or the port cannot be had.
    """

    def __init__(self, *, target: int, host: str = LOOPBACK[0], port: int = 0, token: str | None = None) -> None:
        if host not in LOOPBACK and token is None:
            raise ValueError(f"a door at {host} needs a token; only this machine is let in without")
        self.target, self.host, self.port, self.token = target, host, port, token
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
                return await _answer(writer, "503 Service Unavailable", "too many connections")
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_SECONDS)
            refusal, extra = judged(head, self.token)
            if refusal:
                return await _answer(writer, refusal, refusal.partition(" ")[2], extra)
            inner, outer = await asyncio.open_connection(LOOPBACK[0], self.target)
            outer.write(head)
            await asyncio.gather(_pipe(reader, outer, limited=True), _pipe(inner, writer))
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
            return None
        finally:
            self._connections -= 1
            writer.close()


def new_token() -> str:
    """A token that cannot be guessed."""
    return secrets.token_urlsafe(16)


def judged(head: bytes, token: str | None) -> tuple[str, str]:
    """A status and headers to answer a first request with; an empty status lets it in.

    Args:
        head: Request line and headers.
        token: What it must know; ``None`` where it must be addressed to this machine instead.
    """
    first, *rest = head.decode("latin-1").split("\r\n")
    headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(":") for line in rest)}
    parts = first.split(" ")
    if len(parts) != 3 or parts[0] not in ("GET", "HEAD"):
        return "405 Method Not Allowed", ""
    host = headers.get("host", "")
    if token is None and urlsplit(f"//{host}").hostname not in LOOPBACK:
        return "421 Misdirected Request", ""  # a name of somebody else's that leads here
    origin = headers.get("origin")
    if origin is not None and urlsplit(origin).netloc != host:
        return "403 Forbidden", ""  # a page of somebody else's
    if token is None:
        return "", ""
    given = parse_qs(urlsplit(parts[1]).query).get("token", [""])[0]
    pairs = (pair.strip().partition("=") for pair in headers.get("cookie", "").split(";"))
    cookies = {name: value for name, _, value in pairs}
    if hmac.compare_digest(cookies.get(COOKIE, "").encode(), token.encode()):
        return "", ""
    if hmac.compare_digest(given.encode(), token.encode()):
        cookie = f"{COOKIE}={token}; Path=/; HttpOnly; SameSite=Strict"
        return "303 See Other", f"Location: /\r\nSet-Cookie: {cookie}\r\n"
    return "403 Forbidden", ""


async def _answer(writer: asyncio.StreamWriter, status: str, text: str, extra: str = "") -> None:
    body = f"{text}\n".encode()
    head = f"HTTP/1.1 {status}\r\n{extra}Content-Type: text/plain\r\nContent-Length: {len(body)}\r\n"
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
