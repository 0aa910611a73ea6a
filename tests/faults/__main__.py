"""Let works of every long command meet faults at random moments: ``python -m faults --kills 100 --seed 0``.

A warm process forks for each. After a fault nothing may lie half-written under its final name, what was finished before
must still be there, the same command must end well, leave no temporary file and come to what it comes to undisturbed,
bit for bit. What was tried is a line of ``trials.jsonl``; a run that is stopped goes on from there.
"""

import argparse
import importlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "study"))
sys.path.insert(0, str(Path(__file__).parents[2] / "plugins" / "tiny"))

import forked
from faults.jobs import JOBS, QUICK, Job, result, whole
from faults.server import kill_server
from training_processes import PRELOADED

SECONDS = 300
"""After which a command hangs."""
STOPPED = {signal.SIGINT: (130, 0, -signal.SIGINT), signal.SIGTERM: (143, 0, -signal.SIGTERM)}
ENVIRONMENT = {"ANYSTYLE_CACHE": "cache", "ANYSTYLE_TRACEBACK": "0"}


class Reference:
    """A work undisturbed: how long it takes, and what it comes to."""

    def __init__(self, name: str, job: Job, root: Path) -> None:
        self.name, self.job, self.root = name, job, root
        self.folder = root / "whole" / name
        self.folder.mkdir(parents=True)
        job.prepare(self.folder)
        self.before = root / "inputs" / name
        shutil.copytree(self.folder, self.before)
        code, said = self.run(self.folder)
        assert code == 0, f"{name} does not run at all: {said[-800:]}"
        self.result = result(self.folder / job.out)
        assert self.result, f"{name} leaves nothing to compare"
        began = time.monotonic()  # of the second time, when files are cached
        assert not (problem := self.finishes(self.fresh())), f"{name} comes to another end by itself: {problem}"
        self.seconds = time.monotonic() - began
        self.size = pages(self.folder) - pages(self.before)

    def fresh(self, finished: bool = False) -> Path:
        """A folder with the inputs; with the results, too, where the work was finished before."""
        folder = self.root / "trial"
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(self.folder if finished else self.before, folder)
        return folder

    def start(self, folder: Path, words: tuple[str, ...] = ()) -> int:
        """The command in a folder, at work."""
        return forked.start(words or self.job.words, folder, folder.with_suffix(".txt"), ENVIRONMENT)

    def run(self, folder: Path) -> tuple[int | None, str]:
        """The command in a folder, to its end."""
        code = forked.ended(self.start(folder), SECONDS)
        return code, folder.with_suffix(".txt").read_text(errors="replace")

    def finishes(self, folder: Path) -> str:
        """What is wrong with what the same command does now, and leaves; empty where all is well."""
        code, said = self.run(folder)
        if code != 0:
            return f"the same command ends with {code}: {said[-300:]}"
        if litter := temporary(folder):
            return f"left behind: {litter[:3]}"
        if (now := result(folder / self.job.out)) != self.result:
            return f"another result: {sorted(set(now.items()) ^ set(self.result.items()))[:3]}"
        return ""


def pages(folder: Path) -> int:
    """The room that a folder takes on a disk in memory."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    return sum(-(-size // 4096) * 4096 for size in sizes)


def temporary(folder: Path) -> list[str]:
    """Files and folders of works that are under way."""
    return [
        str(path.relative_to(folder))
        for path in folder.rglob("*")
        if path.name.startswith(".") and path.name not in (".lock", ".hydra", ".anystyle")
    ]


def torn(folder: Path) -> str:
    """What lies half-written under its final name."""
    hidden = (".partial", ".trial", ".replaced")
    for path in sorted(folder.rglob("*")):
        parts = path.relative_to(folder).parts
        if path.is_file() and not path.name.startswith(".") and not any(part.startswith(hidden) for part in parts):
            problem = "" if "log" in parts else whole(path)
            if problem:
                return f"half-written: {problem}"
    return ""


def killed(reference: Reference, draw: random.Random) -> tuple[str, str]:
    """``kill -9`` at a random moment, in one of three cases of a work that was finished before."""
    finished, over, moment = draw.random() < 1 / 3, True, draw.uniform(0, reference.seconds)
    while over:
        folder = reference.fresh(finished)
        child = reference.start(folder)
        time.sleep(moment)
        over = os.waitpid(child, os.WNOHANG)[0] != 0
        if not over:
            forked.kill(child)
        else:
            moment *= draw.random()
    note = f"after {moment:.2f} s{', finished before' if finished else ''}"
    problem = torn(folder)
    if finished and not problem:
        lost = set(reference.result) - set(result(folder / reference.job.out))
        problem = f"lost: {sorted(lost)[:3]}" if lost else ""
    return problem or reference.finishes(folder), note


def told_to_stop(number: signal.Signals, reference: Reference, draw: random.Random) -> tuple[str, str]:
    """A signal at a random moment."""
    folder = reference.fresh()
    child = reference.start(folder)
    moment = draw.uniform(0, reference.seconds)
    time.sleep(moment)
    code = None
    if os.waitpid(child, os.WNOHANG)[0] == 0:
        os.kill(child, number)
        code = forked.ended(child, SECONDS)
    said = folder.with_suffix(".txt").read_text(errors="replace")
    note = f"after {moment:.2f} s, exit status {code}"
    if code is not None and code not in STOPPED[number]:
        return f"exit status {code}: {said[-300:]}", note
    if "Traceback" in said:
        return f"a traceback: {said[-300:]}", note
    if code != -number and (litter := temporary(folder)):
        return f"left behind: {litter[:3]}", note
    return torn(folder) or reference.finishes(folder), note


def no_room(reference: Reference, draw: random.Random) -> tuple[str, str]:
    """A disk of random size that is full before the work is done; afterwards there is room."""
    folder = reference.fresh()
    room = int(reference.size * draw.uniform(0, 0.9))
    with mounted(folder, f"size={room + pages(folder) + 4096}"):
        code, said = reference.run(folder)
        problem = refused(code, said) or torn(folder)
        subprocess.run(["mount", "-o", "remount,size=1g", folder], check=True)
        return problem or reference.finishes(folder), f"of {reference.size >> 10} KiB there are {room >> 10}"


def read_only(reference: Reference, draw: random.Random) -> tuple[str, str]:
    """A disk that becomes read-only before the work begins."""
    folder = reference.fresh()
    with mounted(folder, "size=1g"):
        subprocess.run(["mount", "-o", "remount,ro", folder], check=True)
        code, said = reference.run(folder)
        problem = refused(code, said)
        subprocess.run(["mount", "-o", "remount,rw", folder], check=True)
        return problem or reference.finishes(folder), "from the beginning"


def vanished(reference: Reference, draw: random.Random) -> tuple[str, str]:
    """Inputs that are deleted one after another while they are read."""
    folder = reference.fresh()
    child = reference.start(folder)
    moment = draw.uniform(0, reference.seconds)
    time.sleep(moment)
    inputs = sorted(folder.rglob(reference.job.inputs))
    draw.shuffle(inputs)
    for path in inputs[: draw.choice((1, len(inputs)))]:
        path.unlink()
    code = forked.ended(child, SECONDS)
    said = folder.with_suffix(".txt").read_text(errors="replace")
    problem = "" if code == 0 else refused(code, said)
    if not problem and temporary(folder):
        problem = f"left behind: {temporary(folder)[:3]}"
    for path in inputs:
        shutil.copyfile(reference.before / path.relative_to(folder), path)
    return problem or torn(folder), f"after {moment:.2f} s, exit status {code}"


def refused(code: int | None, said: str) -> str:
    """What is wrong with an error."""
    lines = [line for line in said.splitlines() if line.startswith("anystyle: error: ")]
    if code != 2 or len(lines) != 1 or "Traceback" in said:
        return f"exit status {code}: {said[-400:]}"
    return ""


@contextmanager
def mounted(folder: Path, options: str) -> Iterator[None]:
    """A folder on a disk of its own, in memory, with what is in it."""
    aside = folder.with_name("aside")
    folder.rename(aside)
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], check=True)
    try:
        shutil.copytree(aside, folder, dirs_exist_ok=True)
        shutil.rmtree(aside)
        yield
    finally:
        subprocess.run(["umount", "-l", folder], check=True)


Trial = Callable[[Reference, random.Random], tuple[str, str]]
FAULTS: dict[str, Trial] = {
    "kill -9": killed,
    "SIGINT": partial(told_to_stop, signal.SIGINT),
    "SIGTERM": partial(told_to_stop, signal.SIGTERM),
    "full disk": no_room,
    "read-only": read_only,
    "vanished input": vanished,
}


def can_mount(root: Path) -> bool:
    """Whether this process may make disks."""
    probe = root / "probe"
    probe.mkdir()
    if os.geteuid() or subprocess.run(["mount", "-t", "tmpfs", "tmpfs", probe], capture_output=True).returncode:
        return False
    return subprocess.run(["umount", probe]).returncode == 0


def faults(kills: int, others: int, seed: int, keep: Path, only: str = "") -> int:
    """Run trials that are not in the record yet; returns how many of all ended badly."""
    keep.mkdir(parents=True, exist_ok=True)
    record = keep / f"trials-{seed}.jsonl"
    tried = [json.loads(line) for line in record.read_text().splitlines()] if record.is_file() else []
    done = {(row["fault"], row["work"], row["number"]) for row in tried}

    def note(fault: str, work: str, number: int, outcome: tuple[str, str]) -> None:
        row = {"fault": fault, "work": work, "number": number, "problem": outcome[0], "note": outcome[1]}
        tried.append(row)
        with record.open("a") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{fault}, {work}, {number} {outcome[1]}: {outcome[0] or 'well'}", flush=True)

    with tempfile.TemporaryDirectory() as directory:
        root, works = Path(directory), (*JOBS, "study server")
        references: dict[str, Reference] = {}
        forked.warm()
        for name in PRELOADED:
            importlib.import_module(name)
        disks = can_mount(root)
        for fault, trial in FAULTS.items():
            for work in works if fault == "kill -9" else (*JOBS, *QUICK):
                if fault in ("full disk", "read-only") and not disks:
                    continue
                count = min(others, 1) if fault == "read-only" else others
                if fault == "kill -9":
                    count = kills // len(works) + (works.index(work) < kills % len(works))
                numbers = [number for number in range(count) if (fault, work, number) not in done]
                if not numbers or only not in f"{fault}, {work}":
                    continue
                if work == "study server":
                    for number, outcome in kill_server(root / "served", numbers, seed):
                        note(fault, work, number, outcome)
                    continue
                job = (JOBS | QUICK)[work]
                if fault == "vanished input" and not job.inputs:
                    continue
                reference = references.get(work) or references.setdefault(work, Reference(work, job, root))
                for number in numbers:
                    note(fault, work, number, trial(reference, random.Random(f"{seed} {fault} {work} {number}")))
    print(table(tried))
    return sum(bool(row["problem"]) for row in tried)


def table(tried: list[dict]) -> str:
    """Trials that ended well, of all, by fault and work."""
    counts = Counter((row["fault"], row["work"], not row["problem"]) for row in tried)
    columns = list(dict.fromkeys(row["fault"] for row in tried))
    lines = ["| | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    for work in dict.fromkeys(row["work"] for row in tried):
        cells = []
        for fault in columns:
            well, badly = counts[fault, work, True], counts[fault, work, False]
            cells.append(f"{well} of {well + badly}" if well + badly else "")
        lines.append(f"| {work} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> int:
    """Run from the command line; the exit status is 0 where all ended well."""
    words = argparse.ArgumentParser(prog="python -m faults", description=__doc__)
    words.add_argument("--kills", type=int, default=100, help="over all works")
    words.add_argument("--others", type=int, default=5, help="of each other fault on each work")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--keep", type=Path, default=Path("out/faults"), help="where the record of trials is")
    words.add_argument("--only", default="", help="trials with this in their name, such as 'kill -9, train'")
    arguments = words.parse_args()
    return int(faults(arguments.kills, arguments.others, arguments.seed, arguments.keep, arguments.only) > 0)


if __name__ == "__main__":
    sys.exit(main())
