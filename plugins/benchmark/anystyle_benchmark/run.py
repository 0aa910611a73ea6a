"""Running methods: each in a process of its own, scene by scene, what is done already left as it is."""

import os
import platform
import re
import shutil
import signal
import subprocess
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import psutil
from filelock import FileLock, Timeout

from anystyle.errors import UserError, listing, one_line
from anystyle.io.atomic import write_json
from anystyle.io.documents import kept_json
from anystyle.io.record import commit, versions
from anystyle_benchmark.environment import interpreter, last_line
from anystyle_benchmark.job import SECONDS, WEIGHTS, AskedStyle, Job, Seconds
from anystyle_benchmark.process import kill
from anystyle_benchmark.results import Cell, Origin, Record, is_done, wrong_images
from anystyle_benchmark.spec import Spec
from anystyle_benchmark.track import Inputs, SceneEntry, StyleEntry

LOG, ORIGIN = "log.txt", "origin.json"
FIRST_POLL, LAST_POLL = 0.01, 0.2
"""Seconds between looks at a process: short at first, as one that soon ends has its peak of memory soon."""


class Ended(NamedTuple):
    """How a process ended: its error if it failed, CPU seconds, and peak MiB; ``None`` where none was run."""

    failure: str = ""
    timed_out: bool = False
    seconds: float = 0.0
    memory: float | None = None


def run_scene(
    inputs: Inputs,
    spec: Spec,
    home: Path,
    scene: SceneEntry,
    styles: Sequence[StyleEntry],
    seed: int,
    root: Path,
    say: Callable[[str], None],
) -> list[Cell]:
    """Have a method render a scene in those styles that are missing, and record each cell; all cells of the scene.

    Styles with a guide that the method cannot follow are left out. ``home`` is the folder of the spec, ``root`` that of
    the results; ``say`` takes a line of progress.
    """
    cells = {
        style.name: Cell(spec.name, seed, scene.name, style.name) for style in styles if style.guide in spec.guides
    }
    size, folder, title = inputs.size(scene), root / spec.name / str(seed) / scene.name, f"{spec.name}, {scene.name}"
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with FileLock(folder / ".lock", timeout=0):
            scratch = folder / ".job"
            interrupted = kept_json(scratch / ORIGIN, Origin) or Origin()
            _collect(scratch / "out", cells, scene.views, size, root, Ended(), interrupted)
            missing = [style for style in styles if style.name in cells and not is_done(cells[style.name], root)]
            if not missing:
                return list(cells.values())
            say(f"{title}, seed {seed}: {len(missing)} style{'s' * (len(missing) > 1)} …")
            shutil.rmtree(scratch, ignore_errors=True)
            (scratch / "out").mkdir(parents=True)
            origin = Origin() if spec.folder is not None else origin_now(spec)
            write_json(scratch / ORIGIN, msgspec.to_builtins(origin))  # for what an interruption leaves whole
            ended = ask(make_job(inputs, scene, missing, seed, scratch.resolve() / "out"), spec, home)
            wanted = {style.name: cells[style.name] for style in missing}
            found = _collect(scratch / "out", wanted, scene.views, size, root, ended, origin)
            failures = {
                name: ended.failure or _absent(scratch, name, scene.views, size) for name in wanted if name not in found
            }
            for name, message in failures.items():
                record = Record("timeout" if ended.timed_out else "failed", message, origin=origin)
                write_json(wanted[name].record(root), msgspec.to_builtins(record))
            (folder / LOG).unlink(missing_ok=True)
            failed = f", {len(failures)} failed: {next(iter(failures.values()))}" if failures else ""
            if failures and (scratch / LOG).is_file():
                (scratch / LOG).replace(folder / LOG)
                failed += f" (output in {folder / LOG})"
            shutil.rmtree(scratch)
            say(f"{title}, seed {seed}: {len(found)} done in {ended.seconds:.0f} CPU s{failed}")
    except Timeout:
        say(f"{title}, seed {seed}: another process is running it")
    return list(cells.values())


def make_job(inputs: Inputs, scene: SceneEntry, styles: Sequence[StyleEntry], seed: int, out: Path) -> Job:
    """What a method is asked."""
    photographs = {stem: str(path.resolve()) for stem, path in inputs.photographs(scene).items()}
    images = {style.name: style.image and str(inputs.path(style.image).resolve()) for style in styles}
    asked = tuple(AskedStyle(style.name, images[style.name], style.text) for style in styles)
    return Job(inputs.track.name, scene.name, photographs, scene.views, inputs.size(scene), asked, seed, str(out))


def ask(job: Job, spec: Spec, home: Path) -> Ended:
    """Have a method do a job, in the folder of the job's results."""
    out, scratch = Path(job.out), Path(job.out).parent
    if spec.folder is not None:
        for style in job.styles:
            images = home / spec.folder / job.scene / style.name
            if images.is_dir():
                shutil.copytree(images, out / style.name)
        return Ended()
    write_json(scratch / "job.json", msgspec.to_builtins(job))
    try:
        python = interpreter(spec.requirements)
    except UserError as error:
        return Ended(one_line(error))
    args = spec.command or ("{python}", "-m", "anystyle_benchmark.ours", "{job}", *(spec.preset or ()))
    places = {"{python}": str(python), "{here}": str(home.resolve()), "{job}": str(scratch / "job.json")}
    for place, value in places.items():
        args = [word.replace(place, value) for word in args]
    return process(args, scratch, spec.hours, ours=not spec.requirements)


def process(args: Sequence[str], folder: Path, hours: float, *, ours: bool = True) -> Ended:
    """Run a program in a folder, its output in a file there, for at most some hours; then all that it started ends.

    Only ``ours`` may import this package: another environment sees nothing of it.
    """
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    if ours:
        package = str(Path(__file__).parents[1])
        variables["PYTHONPATH"] = os.pathsep.join(filter(None, [package, os.environ.get("PYTHONPATH")]))
    deadline, peak, timed_out, before = time.monotonic() + 3600 * hours, 0.0, False, _children()
    pause = FIRST_POLL
    with (folder / LOG).open("wb") as log:
        pipes = {"stdin": subprocess.DEVNULL, "stdout": log, "stderr": log}
        try:
            started = subprocess.Popen(args, cwd=folder, env=variables, start_new_session=True, **pipes)
        except OSError as error:
            return Ended(f"{args[0]} cannot be started ({error.strerror})")
        try:
            while started.poll() is None:
                peak = max(peak, _memory(started.pid))
                if timed_out := time.monotonic() > deadline:
                    break
                time.sleep(pause)
                pause = min(1.2 * pause, LAST_POLL)
        finally:
            if started.poll() is None:
                kill(started)
            started.wait()
    failure = f"was stopped after {hours:g} hours"
    if not timed_out:
        failure = one_line(last_line((folder / LOG).read_bytes()[-(1 << 16) :].decode(errors="replace")))
        if started.returncode < 0:
            failure = f"was ended by {signal.Signals(-started.returncode).name}"
    return Ended(failure if timed_out or started.returncode else "", timed_out, _children() - before, peak)


def _collect(
    out: Path,
    cells: dict[str, Cell],
    views: Sequence[str],
    size: tuple[int, int],
    root: Path,
    ended: Ended,
    origin: Origin,
) -> set[str]:
    """Move the styles whose images are whole to their places, each with its record; the names of these."""
    found = [name for name in cells if not wrong_images(out / name, views, size)]
    said = kept_json(out / SECONDS, Seconds)
    origin = msgspec.structs.replace(origin, weights=kept_json(out / WEIGHTS, dict[str, str]) or {})
    for name in found:
        images, share = cells[name].images(root), ended.seconds / len(found) or None
        seconds = share if said is None else said.styles.get(name, share)
        once = 0.0 if said is None else said.scene
        shutil.rmtree(images, ignore_errors=True)
        (out / name).replace(images)
        record = Record("done", "", seconds, once, ended.memory, origin)
        write_json(cells[name].record(root), msgspec.to_builtins(record))
    return set(found)


def _absent(scratch: Path, name: str, views: Sequence[str], size: tuple[int, int]) -> str:
    """What is wrong with a style that a program left no images of, though it ended well."""
    wrong = wrong_images(scratch / "out" / name, views, size)
    ours = {scratch / name for name in ("job.json", LOG, ORIGIN, f"out/{SECONDS}", f"out/{WEIGHTS}")}
    others = [path for path in scratch.rglob("*") if path.is_file() and path not in ours]
    elsewhere = [str(path.relative_to(scratch)) for path in others if path.parent != scratch / "out" / name]
    return wrong[0] + (f"; it wrote {listing(elsewhere, 3)}" if elsewhere else "")


def _memory(pid: int) -> float:
    """Resident MiB of a process and all that it started."""
    try:
        first = psutil.Process(pid)
        return sum(each.memory_info().rss for each in (first, *first.children(recursive=True))) / 2**20
    except psutil.Error:  # it has ended
        return 0.0


def _children() -> float:
    """CPU seconds of all processes that this one started and waited for."""
    times = os.times()
    return times.children_user + times.children_system


def origin_now(spec: Spec) -> Origin:
    """What makes a method's images now: this code, or the packages of its environment."""
    machine = f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores"
    if spec.requirements:
        packages = dict(re.split(r" *(?:==|@) *", line, maxsplit=1) for line in spec.requirements)
        return Origin(versions={"python": platform.python_version(), **packages}, machine=machine)
    return Origin(code=commit(), versions={"python": platform.python_version(), **versions()}, machine=machine)
