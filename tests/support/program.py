"""The program in this process: the words of a command, its folder and its environment, and how it ends."""

import contextlib
import io
import os
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple
from unittest import mock

import pytest

from anystyle.__main__ import main
from anystyle.registry import catalog, packages


class Done(NamedTuple):
    """How a command ended."""

    status: int
    out: str
    err: str


def program(words: Sequence[str], folder: Path, environment: Mapping[str, str]) -> Done:
    """Run ``anystyle`` with these words; modules that it imports from the folder are forgotten."""
    out, err = io.StringIO(), io.StringIO()
    handler = signal.getsignal(signal.SIGTERM)
    for known in (catalog._static, packages._folder):  # folders may hold other plugins by now
        known.cache_clear()
    with (
        contextlib.chdir(folder),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
        warnings.catch_warnings(action="default"),
        mock.patch.dict(os.environ, environment, clear=True),
        mock.patch.object(sys, "argv", ["anystyle", *words]),
        mock.patch.object(sys, "dont_write_bytecode", True),  # runpy would store what checks types as what does not
        mock.patch.object(sys, "path", [*sys.path]),
    ):
        warnings.filterwarnings("ignore", message="'anystyle.commands", module="runpy")  # imported here already
        try:
            main()
            status = 0
        except SystemExit as left:
            status = left.code if isinstance(left.code, int) else int(left.code is not None)
        except BaseException:
            status = 1
            traceback.print_exc()
    signal.signal(signal.SIGTERM, handler)
    for name, module in [*sys.modules.items()]:
        if (file := getattr(module, "__file__", None)) and Path(file).is_relative_to(folder):
            del sys.modules[name]
    return Done(status, out.getvalue(), err.getvalue())


def failing(main: Callable[[list[str]], object], capsys: pytest.CaptureFixture[str], *words: object) -> str:
    """Run a command that must end in one line and status 2; return the line."""
    with pytest.raises(SystemExit) as caught:
        main([str(word) for word in words])
    assert caught.value.code == 2
    lines = [line for line in capsys.readouterr().err.splitlines() if not line.endswith("…")]
    assert len(lines) == 1 and lines[0].startswith("anystyle: error: "), lines
    return lines[0]
