"""A folder has one process at work, on whatever machine; the lock of one that has gone holds nobody up."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from anystyle.errors import UserError
from anystyle.io import atomic
from anystyle.io.atomic import folder_lock

LEASE = 1.5
HOLDER = """
import socket, sys, time
from pathlib import Path
from anystyle.io import atomic
folder, host, atomic.LEASE = Path(sys.argv[1]), sys.argv[2], float(sys.argv[3])
socket.gethostname = lambda: host
with atomic.folder_lock(folder, "taken") as check:
    print("held", flush=True)
    while sys.stdin.readline():
        check()
        print("still held", flush=True)
"""


@pytest.fixture(autouse=True)
def short_lease(monkeypatch):
    monkeypatch.setattr(atomic, "LEASE", LEASE)


@contextmanager
def holder(folder: Path, host: str = socket.gethostname()) -> Iterator[subprocess.Popen]:
    """Another process that holds a folder, on a host of this name."""
    command, pipe = [sys.executable, "-c", HOLDER, str(folder), host, str(LEASE)], subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "held\n"
        try:
            yield process
        finally:
            process.kill()


def refused(folder: Path) -> str:
    with pytest.raises(UserError) as caught, folder_lock(folder, "another run is in it"):
        pass
    return str(caught.value)


def is_locked(folder: Path) -> bool:
    return atomic._silence(folder) <= LEASE


def test_a_lock_says_who_holds_it_and_ends_with_its_process(tmp_path):
    with holder(tmp_path) as process:
        assert is_locked(tmp_path)
        assert refused(tmp_path) == f"another run is in it (process {process.pid} on {socket.gethostname()})"
        process.kill()
        process.wait()
        with folder_lock(tmp_path, "taken") as check:  # at once: it is known to be dead
            check()
    assert not is_locked(tmp_path) and not list(tmp_path.iterdir())


def test_a_machine_that_lives_keeps_its_lock_and_one_that_has_gone_loses_it(tmp_path):
    with holder(tmp_path, "elsewhere") as process:
        time.sleep(1.5 * LEASE)
        assert refused(tmp_path).endswith(f"(process {process.pid} on elsewhere)")
        process.kill()
        process.wait()
        assert is_locked(tmp_path) and refused(tmp_path)  # it cannot be known yet
        while is_locked(tmp_path):
            time.sleep(0.1)
        with folder_lock(tmp_path, "taken") as check:
            check()


def test_who_slept_and_lost_a_lock_is_told_and_leaves_it_to_the_other(tmp_path):
    with holder(tmp_path, "elsewhere") as process:
        process.send_signal(signal.SIGSTOP)
        while is_locked(tmp_path):
            time.sleep(0.1)
        with folder_lock(tmp_path, "taken") as check:
            process.send_signal(signal.SIGCONT)
            _, told = process.communicate("a step\n", timeout=60)
            assert told.splitlines()[-1].endswith(f"UserError: taken (process {os.getpid()} on {socket.gethostname()})")
            check()
    assert not list(tmp_path.iterdir())


def test_an_empty_lock_of_an_earlier_version_is_taken_over_when_it_is_old(tmp_path):
    (tmp_path / ".lock").touch()
    assert refused(tmp_path) == "another run is in it (another process)"
    os.utime(tmp_path / ".lock", (0, 0))
    with folder_lock(tmp_path, "taken") as check:
        check()
