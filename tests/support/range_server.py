"""A server of files that answers ranges, as object storage does; Python's own sends whole files."""

import http.server
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import ClassVar


class Ranges(http.server.SimpleHTTPRequestHandler):
    """Answers with files below a folder, or ranges of them."""

    protocol_version = "HTTP/1.1"
    log: ClassVar[list[tuple[str, int]]] = []
    """Path and bytes of each answer."""
    busy = 0
    """So many requests are refused with status 503."""

    def log_message(self, *args):
        pass

    def do_GET(self):
        path = Path(self.translate_path(self.path))
        if not path.is_file() or Ranges.busy:
            Ranges.busy -= path.is_file()
            self.send_error(503 if path.is_file() else 404)
            return
        content = path.read_bytes()
        wanted = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        self.send_response(206 if wanted else 200)
        if wanted:
            first, last = int(wanted[1]), int(wanted[2])
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
            content = content[first : last + 1]
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)
        Ranges.log.append((self.path, len(content)))


class Whole(http.server.SimpleHTTPRequestHandler):
    """Answers each request with the whole file."""

    def log_message(self, *args):
        pass


@contextmanager
def serving(folder: Path, handler: type[http.server.SimpleHTTPRequestHandler] = Ranges) -> Iterator[str]:
    """The address at which a folder is served."""
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), partial(handler, directory=str(folder)))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        server.server_close()
