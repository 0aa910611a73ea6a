"""The program in processes that begin where its libraries are imported already: each command starts in no time.

Run as a script it reads lines of JSON with the words of a command, its folder and its environment, does in a process of
its own what ``python -m anystyle`` does with them, and answers with a line: exit status, both streams, CPU seconds.
"""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import NamedTuple


class Done(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    err: str
    seconds: float


class Program:
    """The process that others are started from."""

    def __init__(self) -> None:
        pipe = subprocess.PIPE
        self._process = subprocess.Popen([sys.executable, __file__], stdin=pipe, stdout=pipe, text=True)

    def __call__(self, words: list[str], *, folder: Path, environment: dict[str, str]) -> Done:
        """Run ``anystyle`` with these words."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(
            json.dumps({"words": words, "folder": str(folder), "environment": environment}) + "\n"
        )
        self._process.stdin.flush()
        return Done(*json.loads(self._process.stdout.readline()))

    def close(self) -> None:
        """End it."""
        self._process.communicate()


def _be(words: list[str], folder: str, environment: dict[str, str]) -> None:
    from anystyle.__main__ import main

    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    for stream, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(os.open(f".{name}", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), stream)
    sys.argv = ["anystyle", *words]
    main()


def _child(asked: dict) -> None:
    status = 1
    try:
        _be(**asked)
        status = 0
    except SystemExit as left:
        status = left.code if isinstance(left.code, int) else int(left.code is not None)
    except BaseException:
        sys.excepthook(*sys.exc_info())
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)


def _serve() -> None:
    import warm  # noqa: F401

    for line in sys.stdin:
        asked = json.loads(line)
        child = os.fork()
        if not child:
            _child(asked)
        _, status, usage = os.wait4(child, 0)
        streams = [(Path(asked["folder"]) / name).read_text() for name in (".stdout", ".stderr")]
        seconds = usage.ru_utime + usage.ru_stime
        sys.stdout.write(json.dumps([os.waitstatus_to_exitcode(status), *streams, seconds]) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    _serve()
