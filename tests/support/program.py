"""The program in processes that begin where its libraries are imported already: each command starts in no time.

Run as a script it is the server of a test run, one for all its workers: it takes the words of a command, its folder and
its environment from a socket, with the streams that it writes to, does in a process of its own what
``python -m anystyle`` does with them, and answers with the exit status and the CPU seconds.
"""

import fcntl
import json
import os
import socket
import socketserver
import subprocess
import sys
import tempfile
import traceback
from pathlib import Path
from typing import NamedTuple

SHIM = """#!{python}
import os, sys
sys.path.insert(0, {root!r})
from tests.support.program import ask
sys.exit(ask({address!r}, sys.argv[1:], os.getcwd(), dict(os.environ), (1, 2))[0])
"""


class Done(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    err: str
    seconds: float


class Program:
    """The server of this test run; the first who asks starts it, and it ends with the run.

    Args:
        folder: Of the run, the same for all its workers.
    """

    def __init__(self, folder: Path) -> None:
        with (folder / "program.txt").open("a+") as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            self.address = file.read() or _start()
            file.truncate(0)
            file.write(self.address)

    def __call__(self, words: list[str], *, folder: Path, environment: dict[str, str]) -> Done:
        """Run ``anystyle`` with these words."""
        with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
            status, seconds = ask(self.address, words, str(folder), environment, (out.fileno(), err.fileno()))
            out.seek(0)
            err.seek(0)
            return Done(status, out.read().decode(), err.read().decode(), seconds)

    def install(self, folder: Path) -> Path:
        """Write it as ``anystyle`` into a folder, for shells; answers with the folder."""
        folder.mkdir(parents=True)
        file = folder / "anystyle"
        file.write_text(SHIM.format(python=sys.executable, root=str(Path(__file__).parents[2]), address=self.address))
        file.chmod(0o755)
        return folder


def ask(
    address: str, words: list[str], folder: str, environment: dict[str, str], streams: tuple[int, int]
) -> tuple[int, float]:
    """Let the server run a command; the exit status and the CPU seconds."""
    with socket.socket(socket.AF_UNIX) as connection:
        connection.connect(address)
        socket.send_fds(connection, [b"."], streams)
        connection.sendall(json.dumps({"words": words, "folder": folder, "environment": environment}).encode() + b"\n")
        status, seconds = json.loads(connection.makefile().readline())
        return status, seconds


def _start() -> str:
    """Start a server; it answers once it has imported everything."""
    address = str(Path(tempfile.mkdtemp(prefix="anystyle-")) / "socket")
    # A worker's parent lasts as long as the run.
    run = os.getppid() if "PYTEST_XDIST_WORKER" in os.environ else os.getpid()
    command = [sys.executable, "-m", __spec__.name, address, str(run)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
    with subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True, env=environment) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.returncode = 0  # it goes on
    return address


def _be(words: list[str], folder: str, environment: dict[str, str]) -> None:
    from anystyle.__main__ import main

    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = ["anystyle", *words]
    main()


def _child(asked: dict, streams: list[int]) -> None:
    status = 1
    try:
        for number, stream in enumerate(streams, start=1):
            os.dup2(stream, number)
        _be(**asked)
        status = 0
    except SystemExit as left:
        status = left.code if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


class _Command(socketserver.StreamRequestHandler):
    def handle(self) -> None:
        _, streams, _, _ = socket.recv_fds(self.connection, 1, 2)
        asked = json.loads(self.rfile.readline())
        child = os.fork()
        if not child:
            _child(asked, streams)
        _, status, usage = os.wait4(child, 0)
        answer = json.dumps([os.waitstatus_to_exitcode(status), usage.ru_utime + usage.ru_stime])
        self.wfile.write(answer.encode() + b"\n")


class _Server(socketserver.ForkingMixIn, socketserver.UnixStreamServer):
    def __init__(self, address: str, run: int) -> None:
        super().__init__(address, _Command)
        self.run = run

    def service_actions(self) -> None:
        super().service_actions()
        if not _lives(self.run):
            address = Path(str(self.server_address))
            address.unlink()
            address.parent.rmdir()
            os._exit(0)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def _serve(address: str, run: int) -> None:
    from tests.support import warm  # noqa: F401

    server = _Server(address, run)
    os.write(1, b"ready\n")
    os.dup2(2, 1)
    server.serve_forever()


if __name__ == "__main__":
    _serve(sys.argv[1], int(sys.argv[2]))
