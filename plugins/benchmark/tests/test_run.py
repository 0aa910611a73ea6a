"""Methods run in processes of their own: what they write, take and leave undone is recorded cell by cell."""

import json
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle.io.documents import read_json
from anystyle_benchmark.command_run import main
from anystyle_benchmark.results import Cell, Origin, Record, wrong_images
from anystyle_benchmark.spec import read_spec
from tests.support.pictures import save

PROGRAM = """
import json, sys, pathlib
from PIL import Image
job = json.load(open(sys.argv[1]))
for style in job["styles"]:
    folder = pathlib.Path(job["out"]) / style["name"]
    folder.mkdir(parents=True)
    for view in job["views"]:
        Image.open(job["photographs"][view]).convert("RGB").resize(job["size"][::-1]).save(folder / f"{view}.png")
"""


@pytest.fixture
def world(tmp_path: Path) -> Path:
    """A track of two scenes, two images and a text, with a program that copies photographs."""
    noise = np.random.default_rng(0)
    for scene in ("one", "two"):
        for view in range(3):
            pixels = noise.integers(0, 255, (48, 64, 3), dtype=np.uint8)
            save(tmp_path / "photographs" / scene / f"{view}.jpg", pixels)
    for style in ("a", "b"):
        Image.new("RGB", (32, 32), "red" if style == "a" else "blue").save(tmp_path / f"{style}.png")
    lines = ['name = "small"', "version = 1", 'about = "x"', "short_side = 24", "[metrics]", 'image = ["psnr"]']
    for scene in ("one", "two"):
        lines += ["[[scenes]]", f'name = "{scene}"', f'photographs = "photographs/{scene}"', 'views = ["0", "2"]']
    for style in ("a", "b"):
        lines += ["[[styles]]", f'name = "{style}"', f'image = "{style}.png"']
    lines += ["[[styles]]", 'name = "words"', 'text = "red waves"']
    (tmp_path / "track.toml").write_text("\n".join(lines))
    (tmp_path / "copy.py").write_text(PROGRAM)
    return tmp_path


def method(world: Path, program: str | None = None, *lines: str) -> Path:
    if program is not None:
        (world / "copy.py").write_text(program)
    spec = world / "copier.toml"
    command = 'command = ["{python}", "{here}/copy.py", "{job}"]'
    spec.write_text("\n".join(['name = "copier"', 'title = "Copier"', command, *lines]))
    return spec


def ran(world: Path, spec: Path, *words: str) -> dict[tuple[str, str], Record]:
    out = world / "results"
    main([f"track={world / 'track.toml'}", f"methods={spec}", f"out={out}", *words])
    return {
        (path.parent.name, path.stem): read_json(path, Record)
        for path in sorted((out / "copier" / "0").glob("*/*.json"))
    }


def test_a_command_renders_every_cell_that_it_can_follow(world, capsys):
    records = ran(world, method(world))
    assert set(records) == {(scene, style) for scene in ("one", "two") for style in ("a", "b")}
    assert all(record.status == "done" and record.seconds > 0 for record in records.values())
    images = Cell("copier", 0, "two", "b").images(world / "results")
    assert wrong_images(images, ["0", "2"], (24, 32)) == []
    assert sorted(path.name for path in images.parent.iterdir()) == [".lock", "a", "a.json", "b", "b.json"]
    assert "copier, two, seed 0: 2 done" in capsys.readouterr().err
    assert json.loads((world / "results" / "track.json").read_text())["name"] == "small"


def test_memory_is_the_peak_of_a_method_with_all_that_it_starts(world):
    hold = "import time; held = b'1' * (40 << 20); time.sleep(0.6)"
    start = f"import subprocess, sys; child = subprocess.Popen([sys.executable, '-c', {hold!r}])"
    spec = method(world, "\n".join([start, hold, "child.wait()", PROGRAM]))
    assert all(80 < record.memory < 200 for record in ran(world, spec, "scenes=one").values())


def test_what_is_done_is_not_run_again_and_what_is_missing_is(world):
    calls = world / "calls"
    line = f"\nopen({str(calls)!r}, 'a').write(job['scene'] + str(len(job['styles'])) + '\\n')"
    spec = method(world, PROGRAM + line)
    ran(world, spec, "scenes=one", "styles=a")
    ran(world, spec)
    assert calls.read_text().split() == ["one1", "one1", "two2"]


def test_styles_that_an_interrupted_run_left_whole_are_kept(world):
    spec = method(world, "raise SystemExit('never run')")
    out = world / "results" / "copier" / "0" / "one" / ".job" / "out" / "a"
    out.mkdir(parents=True)
    for view in ("0", "2"):
        Image.new("RGB", (32, 24)).save(out / f"{view}.png")
    write_json(out.parents[1] / "origin.json", {"code": "0123abc"})
    records = ran(world, spec, "scenes=one")
    assert records["one", "a"].status == "done" and records["one", "a"].origin.code == "0123abc"
    assert records["one", "b"].origin.code != "0123abc" and records["one", "b"].message == "never run"


@pytest.mark.parametrize(
    ("program", "lines", "status", "message"),
    [
        ("raise ValueError('no such weights')", [], "failed", "ValueError: no such weights"),
        ("import os; os.kill(os.getpid(), 9)", [], "failed", "was ended by SIGKILL"),
        ("import time; time.sleep(60)", ["hours = 0.0001"], "timeout", "was stopped after 0.0001 hours"),
        ("open('mine.png', 'w')", [], "failed", "there is no a/0.png; it wrote mine.png"),
        (PROGRAM.replace('job["size"][::-1]', "(10, 10)"), [], "failed", "a/0.png is 10x10; 32x24 is expected"),
        (PROGRAM.replace('convert("RGB")', 'convert("L")'), [], "failed", "a/0.png has mode L; 8-bit RGB is expected"),
        (
            PROGRAM.replace(".resize", ".crop((0, 0, 1, 1)).resize") + "\n(folder / '0.png').write_text('x')",
            [],
            "failed",
            "b/0.png is not a readable image",
        ),
    ],
)
def test_a_program_that_fails_leaves_a_line_in_its_cells(world, capsys, program, lines, status, message):
    records = ran(world, method(world, program, *lines), "scenes=one")
    assert any(record.status == status and message in record.message for record in records.values()), records
    assert f"failed: {message}" in capsys.readouterr().err


def test_a_child_of_a_stopped_program_does_not_live_on(world):
    pid = world / "pid"
    program = f"""
import pathlib, subprocess, time
pathlib.Path({str(pid)!r}).write_text(str(subprocess.Popen(["sleep", "77"]).pid))
time.sleep(60)
"""
    ran(world, method(world, program, "hours = 0.0005"), "scenes=one")
    time.sleep(0.1)
    child = Path(f"/proc/{pid.read_text()}/stat")
    assert not child.is_file() or child.read_text().split()[2] == "Z"


def test_a_folder_of_images_is_a_method(world):
    images = world / "theirs" / "one" / "a"
    images.mkdir(parents=True)
    for view in ("0", "2"):
        Image.new("RGB", (32, 24)).save(images / f"{view}.png")
    spec = world / "theirs.toml"
    spec.write_text('name = "copier"\ntitle = "T"\nfolder = "theirs"')
    records = ran(world, spec)
    assert records["one", "a"].status == "done" and records["one", "a"].seconds is None
    assert records["two", "b"].message == "there is no b/0.png"
    record = records["one", "a"]  # what made images elsewhere is unknown
    assert (record.memory, record.origin) == (None, Origin())


def test_what_a_failed_program_printed_is_kept_until_it_succeeds(world, capsys):
    log = world / "results" / "copier" / "0" / "one" / "log.txt"
    ran(world, method(world, "print('loading'); raise ValueError('no such weights')"), "scenes=one")
    text = log.read_text()
    assert text.startswith("loading\nTraceback") and text.endswith("ValueError: no such weights\n")
    assert f"output in {log}" in capsys.readouterr().err
    ran(world, method(world, PROGRAM), "scenes=one")
    assert not log.exists()


def test_a_run_ends_with_what_there_is_and_what_comes_next(world, capsys):
    spec, results, track = method(world), world / "results", world / "track.toml"
    ran(world, spec, "scenes=one")
    ran(world, spec, "scenes=one", "seeds=[0,3]")
    lines = capsys.readouterr().err.splitlines()
    assert "copier has 1 seed; seed 3 is left out" in lines
    assert lines[-1] == f"2 of 2 cells are done; next: anystyle benchmark judge {results} --track {track}"


def test_images_of_another_program_of_the_same_name_are_refused(world):
    spec = method(world, "raise ValueError")
    ran(world, spec, "scenes=one")
    spec = method(world, PROGRAM, 'hours = 1.0\nseeds = 2\nabout = "Mended."')  # nothing was made yet
    spec.write_text(spec.read_text().replace("copy.py", f"../{world.name}/copy.py"))
    ran(world, spec, "scenes=one", "seeds=0")
    kept = (world / "results" / "copier" / "method.json").read_bytes()
    spec.write_text(spec.read_text().replace('"{job}"', '"--fast", "{job}"'))
    with pytest.raises(UserError, match=r"copier holds images made by another command; delete it, or name the method"):
        ran(world, spec)
    assert (world / "results" / "copier" / "method.json").read_bytes() == kept


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["method=noise"], "no option is named 'method'. Did you mean 'methods'"),
        (["methods=noise", "styles=c"], "no style is named 'c'"),
        (["methods=nowhere.toml"], "there is no spec of a method nowhere.toml"),
        (["methods=noise", "seeds=one"], "give integers of at least 0"),
    ],
)
def test_slips_are_one_line_and_run_nothing(world, words, message):
    with pytest.raises(UserError, match=message):
        main([f"track={world / 'track.toml'}", f"out={world / 'results'}", *words])
    assert not (world / "results").exists()


def test_results_of_another_track_are_refused(world):
    spec = method(world)
    ran(world, spec, "scenes=one", "styles=a")
    Image.new("RGB", (32, 32), "green").save(world / "b.png")
    kept = (world / "results" / "track.json").read_bytes()
    with pytest.raises(UserError, match=r"cannot hold results of .*track\.toml: its inputs differ; use another$"):
        ran(world, spec)
    assert (world / "results" / "track.json").read_bytes() == kept
    (world / "results" / "track.json").write_text("{")
    with pytest.raises(UserError, match=r"track\.json is not a valid record of the results' track"):
        ran(world, spec)


def test_a_multirun_fills_one_folder(world):
    records = ran(world, method(world), "-m", "scenes=one,two")
    assert {scene for scene, _ in records} == {"one", "two"}
    assert all(record.status == "done" for record in records.values())


def test_a_preset_of_ours_runs_on_an_example(tmp_path, world):
    spec = world / "ours.toml"
    words = 'preset = ["model=tiny", "poses=predicted", "reconstruction=feedforward"]'
    spec.write_text(f'name = "copier"\ntitle = "T"\n{words}\nguides = ["image", "text"]')
    records = ran(world, spec, "scenes=one")
    assert {name: record.message for (_, name), record in records.items()} == {"a": "", "b": "", "words": ""}
    assert records["one", "a"].scene_seconds > 0


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('name = "x"\ntitle = "T"', "gives nothing; a spec has one of"),
        ('name = "x"\ntitle = "T"\nfolder = "f"\nnot_run = "x"', "gives folder and not_run"),
        ('name = "x"\ntitle = "T"\ncommand = ["x"]\nrequirements = ["numpy"]', "requirements are pinned"),
        ('name = "../x"\ntitle = "T"\nfolder = "f"', "name"),
        ('name = "x"\ntitle = "T"\nfolder = "f"', r"x\.toml: there is no folder .*f"),
    ],
)
def test_a_spec_that_says_too_little_or_too_much_is_refused(tmp_path, text, message):
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(UserError, match=message):
        read_spec(str(tmp_path / "x.toml"))
