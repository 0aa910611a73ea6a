"""Files and folders that appear whole or not at all."""

import signal
import subprocess
import sys

import pytest

from anystyle.cli.run import run
from anystyle.errors import UserError
from anystyle.io.atomic import atomic_directory, atomic_path, write_json


def test_a_failed_write_leaves_the_old_file(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("old")
    with pytest.raises(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "old" and [path.name for path in tmp_path.iterdir()] == ["a.txt"]
    with pytest.raises(UserError, match="is a folder; name a file"), atomic_path(tmp_path):
        raise AssertionError("before anything is made for it")


def test_a_directory_appears_whole_and_replaces_what_it_names(tmp_path):
    target = tmp_path / "out"
    with atomic_directory(target) as temporary:
        (temporary / "renders").mkdir()
        (temporary / "renders" / "stale.png").touch()
    (target / "mine.txt").touch()
    with atomic_directory(target) as temporary:
        (temporary / "renders").mkdir()
        (temporary / "renders" / "new.png").touch()
        (temporary / "report.json").touch()
    names = sorted(str(path.relative_to(target)) for path in target.rglob("*"))
    assert names == [".anystyle", "mine.txt", "renders", "renders/new.png", "report.json"]


def test_what_stays_of_an_earlier_run_is_told(tmp_path, caplog):
    for names in (("01-wave", "report.json"), ("scene.ply", "report.json")):
        with atomic_directory(tmp_path) as temporary:
            for name in names:
                (temporary / name).touch()
    assert caplog.messages == [f"{tmp_path} also holds 01-wave of an earlier run"]


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def write(target, *names, **options):
    with atomic_directory(target, **options) as temporary:
        for name in names:
            (temporary / name).parent.mkdir(exist_ok=True)
            (temporary / name).touch()


def test_an_earlier_run_is_replaced_and_files_of_people_stay(tmp_path):
    write(tmp_path, "renders/1.png", "renders/2.png", "01-wave/scene.ply", "02-ink/scene.ply", "report.json")
    mine = [".anystyle", "01-wave/edited.psd", "notes.txt", "renders/cut.png"]
    for name in mine[1:]:
        (tmp_path / name).touch()
    write(tmp_path, "renders/1.png", "report.json", overwrite=True)
    assert files_in(tmp_path) == sorted([*mine, "renders/1.png", "report.json"])
    assert not (tmp_path / "02-ink").exists()
    with pytest.raises(UserError, match=r"cut\.png is there already and was not made by anystyle"):
        write(tmp_path, "renders/cut.png", overwrite=True)
    assert files_in(tmp_path) == sorted([*mine, "renders/1.png", "report.json"])


def test_a_list_of_folders_by_an_earlier_version_is_understood(tmp_path):
    write(tmp_path, "renders/1.png", "renders/2.png", "report.json")
    write_json(tmp_path / ".anystyle", ["renders", "report.json"])
    write(tmp_path, "renders/1.png")
    assert files_in(tmp_path) == [".anystyle", "renders/1.png", "report.json"]


def test_what_this_program_did_not_make_is_never_replaced(tmp_path):
    (tmp_path / "sparse").mkdir()
    (tmp_path / "sparse" / "cameras.bin").write_bytes(b"of the capture")
    with pytest.raises(UserError, match="sparse is there already and"), atomic_directory(tmp_path, ["sparse"]):
        pytest.fail("no work is begun")
    with pytest.raises(UserError, match="sparse is there already"), atomic_directory(tmp_path) as temporary:
        (temporary / "a").touch()
        (temporary / "sparse").mkdir()
    assert [str(path.relative_to(tmp_path)) for path in sorted(tmp_path.rglob("*"))] == ["sparse", "sparse/cameras.bin"]


def test_a_failed_directory_leaves_nothing(tmp_path):
    with pytest.raises(RuntimeError), atomic_directory(tmp_path / "a" / "b") as temporary:
        (temporary / "x").touch()
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_a_terminated_command_deletes_what_it_began(tmp_path):
    code = (
        "import signal\nfrom anystyle.cli.run import run\nfrom anystyle.io.atomic import atomic_directory\n"
        "def command():\n"
        "    with atomic_directory('out') as temporary:\n"
        "        (temporary / 'half.png').touch()\n"
        "        print('begun', flush=True)\n"
        "        while True: signal.pause()\n"
        "run(command)"
    )
    pipe = subprocess.PIPE
    with subprocess.Popen([sys.executable, "-c", code], cwd=tmp_path, stdout=pipe, stderr=pipe, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "begun\n"
        process.send_signal(signal.SIGTERM)
        assert process.communicate(timeout=60)[1] == "anystyle: terminated\n"
    assert process.returncode == 143 and list(tmp_path.iterdir()) == []


def test_an_error_about_a_program_that_exits_is_an_error(capsys):
    def command() -> None:
        try:
            sys.exit(0)
        except SystemExit as end:
            raise UserError("it ended too early") from end

    with pytest.raises(SystemExit) as ended:
        run(command)
    assert ended.value.code == 2 and capsys.readouterr().err == "anystyle: error: it ended too early\n"


@pytest.mark.parametrize(("name", "status"), [("SIGTERM", 143), ("SIGINT", 130)])
def test_a_signal_is_no_error_where_a_library_makes_one_of_it(capsys, name, status):
    """OmegaConf does, in the midst of composing."""

    def command() -> None:
        try:
            signal.raise_signal(signal.Signals[name])
        finally:
            raise AttributeError("'NoneType' object has no attribute 'flags'")

    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell lets what it starts behind itself ignore it
    with pytest.raises(SystemExit) as ended:
        run(command)
    for number, handler in zip((signal.SIGTERM, signal.SIGINT), before, strict=True):
        signal.signal(number, handler)
    told = {"SIGTERM": "terminated", "SIGINT": "interrupted"}[name]
    assert ended.value.code == status and capsys.readouterr().err == f"anystyle: {told}\n"
