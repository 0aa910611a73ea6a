import platform
import signal
import subprocess
import sys

import pytest

from anystyle.io.atomic import atomic_directory, atomic_path, folder_lock


def test_a_failed_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    for name in ("a", "another"):  # of a process that is no more
        (tmp_path / f".{name}-{platform.node()}-999999999-ab_12xyz.txt").touch()
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["a.txt"]


def test_a_directory_appears_whole_and_replaces_what_it_names(tmp_path):
    target = tmp_path / "out"
    with atomic_directory(target) as temporary:
        (temporary / "renders").mkdir()
        (temporary / "renders" / "stale.png").touch()
    (target / "mine.txt").touch()
    (target / f".partial-{platform.node()}-999999999-x").mkdir()  # of a process that is no more
    with atomic_directory(target) as temporary:
        (temporary / "renders").mkdir()
        (temporary / "renders" / "new.png").touch()
        (temporary / "report.json").touch()
    assert sorted(str(path.relative_to(target)) for path in target.rglob("*")) == [
        ".anystyle",
        "mine.txt",
        "renders",
        "renders/new.png",
        "report.json",
    ]


def test_a_folder_that_a_killed_process_was_about_to_replace_is_put_back(tmp_path):
    before = tmp_path / f".replaced-{platform.node()}-999999999-x" / "renders"
    before.mkdir(parents=True)
    (before / "a.png").touch()
    (tmp_path / ".anystyle").write_text('["renders"]')
    with pytest.raises(RuntimeError), atomic_directory(tmp_path):
        assert (tmp_path / "renders" / "a.png").is_file() and not list(tmp_path.glob(".replaced-*"))
        raise RuntimeError
    assert (tmp_path / "renders" / "a.png").is_file()


def test_what_this_program_did_not_make_is_never_replaced(tmp_path):
    (tmp_path / "sparse").mkdir()
    (tmp_path / "sparse" / "cameras.bin").write_bytes(b"a capture's own")
    refused = pytest.raises(ValueError, match="sparse is there already and was not made")
    with refused, atomic_directory(tmp_path, ["sparse"]):
        pytest.fail("no work is begun")
    with pytest.raises(ValueError, match="sparse is there already"), atomic_directory(tmp_path) as temporary:
        (temporary / "a").touch()
        (temporary / "sparse").mkdir()
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == ["sparse", "sparse/cameras.bin"]


def test_a_failed_directory_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), atomic_directory(tmp_path / "a" / "b") as temporary:
        (temporary / "x").touch()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_file_is_no_directory(tmp_path):
    (tmp_path / "f").touch()
    with pytest.raises(ValueError, match="is a file"), atomic_directory(tmp_path / "f"):
        pass


HOLDER = """
import sys, time
from pathlib import Path
from anystyle.io.atomic import folder_lock
with folder_lock(Path(sys.argv[1]), "taken"):
    print("held", flush=True)
    time.sleep(600)
"""


def test_a_folder_is_locked_against_other_processes_until_its_holder_ends_however_it_ends(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None and holder.stdout.readline() == "held\n"
        with pytest.raises(ValueError, match="another run is in it"), folder_lock(tmp_path, "another run is in it"):
            pass
        holder.kill()
    with folder_lock(tmp_path, "taken"):
        pass


def test_a_command_that_is_terminated_clears_away_what_it_began(tmp_path):
    code = (
        "import signal\nfrom anystyle.commands._run import run\nfrom anystyle.io.atomic import atomic_directory\n"
        "def command():\n"
        "    with atomic_directory('out') as temporary:\n"
        "        (temporary / 'half.png').touch()\n"
        "        print('begun', flush=True)\n"
        "        while True: signal.pause()\n"
        "run(command)"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=60)[1] == "anystyle: terminated\n"
    assert process.returncode == 143
    assert list(tmp_path.rglob("*.png")) == [] and list(tmp_path.rglob(".partial-*")) == []
