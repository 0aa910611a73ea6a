"""A sweep that is disturbed at random moments until it is finished: its table has always the same bytes.

``python -m tests.benchmarks.kills --faults 200 --out DIR`` (Linux, root, for it mounts a disk in memory) trains twelve
jobs in two processes, with the smallest training there is. A fault strikes at a random moment; the same command is
started again, until it ends well; then the next sweep begins. It fails at the first sweep

- whose table, or any of whose figures and weights, differs by one byte from that of a sweep that nobody disturbed;
- that changed a job which was finished: a file's content, its inode or its time;
- that ended with a traceback, or with status 2 and not one line that says why.

The faults: ``kill`` (SIGKILL to a start with all its processes), ``kill job`` (to one of its processes alone),
``ctrl-c`` (SIGINT to all, as a terminal sends it), ``terminate`` (SIGTERM to all, as a scheduler does), ``full`` (the
disk has no byte left, for up to three seconds), ``read-only`` (nothing in the folder can be changed, for as long),
``second`` (the same command on the same folder, also under another host's name). ``DIR/log.txt`` has a line for each:
when, what was at work, and what was said in the end. Processes are forked from one that has imported everything, so
that most of their time is a job's; those of submitit are not.
"""

import argparse
import hashlib
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path

import psutil

from tests.support.processes import forking
from tests.support.toy_sweep import LEASE, run, sweep_words, write_plugin

KINDS = {"kill": 4, "kill job": 1, "ctrl-c": 2, "terminate": 2, "full": 4, "read-only": 4, "second": 4}
"""Faults, and how often each is chosen."""
LAUNCHERS = {
    "joblib": ("hydra/launcher=joblib", "hydra.launcher.n_jobs=2"),
    # Which starts a process for every job of a batch.
    "submitit_local": (
        "hydra/launcher=submitit_local",
        "hydra.launcher.timeout_min=60",
        "hydra.sweeper.max_batch_size=2",
    ),
}
ENDS = (0, 2, 130, 143, -signal.SIGKILL, -signal.SIGINT, -signal.SIGTERM)
FILES = ("table.csv", "table.md", "table.tex")


@dataclass
class Start:
    """A start of the command."""

    process: BaseProcess
    output: Path
    killed: bool = False

    def said(self) -> str:
        return self.output.read_text(errors="replace")

    def everyone(self) -> list[psutil.Process]:
        with suppress(psutil.NoSuchProcess):
            first = psutil.Process(self.process.pid)
            return [first, *first.children(recursive=True)]
        return []


class Trial:
    """Sweeps in one place, one after the other, and what happened to them."""

    def __init__(
        self, out: Path, launcher: str, seed: int, seeds: str = "0,1,2", kinds: Mapping[str, int] = KINDS
    ) -> None:
        self.out, self.launcher, self.chance = out.absolute(), launcher, random.Random(seed)
        self.seeds, self.kinds, self.jobs = seeds, kinds, 4 * len(seeds.split(","))
        self.disk = self.out / "disk"
        self.sweep = self.disk / "sweep"
        self.counts: Counter[str] = Counter()
        self.told: Counter[str] = Counter()
        self.starts: list[Start] = []
        self.number = 0
        self.finished: dict[str, Mapping[str, tuple[str, int, int]]] = {}
        for folder in (self.disk, self.out / "said"):
            folder.mkdir(parents=True, exist_ok=True)
        self.environment = write_plugin(self.out / "plugin") | {"OMP_NUM_THREADS": "1"}
        if {"full", "read-only"} & kinds.keys():
            subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64m", "tmpfs", str(self.disk)], check=True)

    def close(self) -> None:
        for start in self.starts:
            self.end(start, signal.SIGKILL)
        if {"full", "read-only"} & self.kinds.keys():
            subprocess.run(["chattr", "-R", "-i", str(self.disk)], check=False)
            subprocess.run(["umount", "--lazy", str(self.disk)], check=False)

    def log(self, line: str) -> None:
        with (self.out / "log.txt").open("a") as file:
            file.write(f"{line}\n")

    def start(self, host: str | None = None, launcher: str | None = None) -> Start:
        self.number += 1
        output = self.out / "said" / f"{self.number:04d}.txt"
        output.touch()
        words = ["train", "-m", *LAUNCHERS[launcher or self.launcher], *sweep_words(self.sweep, self.seeds)]
        self.starts.append(Start(self.run(words, output, host), output))
        return self.starts[-1]

    def run(self, words: Sequence[str], output: Path, host: str | None = None) -> BaseProcess:
        process = forking().Process(target=run, args=(words, self.disk, output, self.environment, host))
        process.start()
        return process

    def end(self, start: Start, number: signal.Signals) -> None:
        start.killed = True
        for process in start.everyone():
            with suppress(psutil.NoSuchProcess):
                process.send_signal(number)

    def at_work(self, since: float = 0.0) -> list[str]:
        """The jobs whose locks were taken or refreshed after a time; those of killed processes stay as they were."""
        locks = []
        for path in self.sweep.glob("*/.lock"):
            with suppress(FileNotFoundError):
                if path.stat().st_mtime > since:
                    locks.append(path.parent.name)
        return sorted(locks, key=int)

    def look(self) -> None:
        """Nothing that was finished has changed since; remember what is finished now."""
        for job, before in self.finished.items():
            now = files(self.sweep / job)
            assert now == before, f"job {job} was finished and has changed: {sorted(now.items() ^ before.items())}"
        for path in self.sweep.glob("*/metrics.json"):
            if path.parent.name not in self.finished and not (path.parent / ".lock").exists():
                self.finished[path.parent.name] = files(path.parent)

    def pause(self, seconds: float) -> None:
        """Look at the folder while time passes; forget the starts that have ended."""
        end = time.monotonic() + seconds
        while time.monotonic() < end and self.starts:
            self.look()
            self.judge()
            time.sleep(0.1)

    def judge(self) -> None:
        """Judge the starts that have ended."""
        for start in [start for start in self.starts if start.process.exitcode is not None]:
            self.starts.remove(start)
            status, said = start.process.exitcode, start.said()
            errors = [line for line in said.splitlines() if line.startswith("anystyle: error: ")]
            where = f"{start.output}, which ended with {status}"
            assert "Traceback" not in said, f"a traceback in {where}"
            assert status in ENDS and (start.killed or status in (0, 2)), where
            assert status != 2 or len(errors) == 1, f"not one line says why in {where}"
            self.told.update(re.sub(r"'.*?'|\S*/\S+|\d+", "…", line) for line in errors)
            self.log(f"    start {start.output.stem} ended with {status}: {(said.splitlines() or ['nothing'])[-1]}")

    def fault(self, kind: str, moment: float) -> None:
        start = self.chance.choice([start for start in self.starts if not start.killed])
        self.counts[kind] += 1
        self.log(
            f"{sum(self.counts.values()):4d} {kind:10} {moment:5.1f} s after start {self.starts[-1].output.stem}; "
            f"at work on {', '.join(self.at_work()) or 'nothing'}; finished {len(self.finished)}"
        )
        if kind == "kill":
            self.end(start, signal.SIGKILL)
        elif kind == "kill job":
            victims = [process for process in start.everyone()[1:] if process.is_running()]
            if victims:
                start.killed = True
                with suppress(psutil.NoSuchProcess):
                    self.chance.choice(victims).kill()
        elif kind == "ctrl-c":
            self.end(start, signal.SIGINT)
        elif kind == "terminate":
            self.end(start, signal.SIGTERM)
        elif kind == "second":
            self.start(self.chance.choice([None, "another"]) if os.geteuid() == 0 else None)
        elif kind == "full":
            with suppress(OSError), (self.disk / "filler").open("wb", buffering=0) as filler:
                while filler.write(bytes(1 << 16)):
                    pass
            self.pause(self.chance.uniform(0.3, 3))
            (self.disk / "filler").unlink()
        elif self.sweep.is_dir():
            subprocess.run(["chattr", "-R", "+i", str(self.sweep)], check=False, stderr=subprocess.DEVNULL)
            self.pause(self.chance.uniform(0.3, 3))
            subprocess.run(["chattr", "-R", "-i", str(self.sweep)], check=True)

    def whole(self) -> dict[str, str]:
        """A sweep that nobody disturbs, by joblib, whose processes begin at once."""
        start, began = self.start(launcher="joblib"), time.monotonic()
        start.process.join()
        self.job_seconds = (time.monotonic() - began) / self.jobs
        assert start.process.exitcode == 0, start.said()
        self.starts.clear()
        return self.results()

    def results(self) -> dict[str, str]:
        """The hashes of the table's files, and of every job's figures and weights."""
        report = self.run(["report", str(self.sweep)], self.out / "report.txt")
        report.join()
        assert report.exitcode == 0, (self.out / "report.txt").read_text()
        weights = [self.sweep / str(job) / "backbone.safetensors" for job in range(self.jobs)]
        paths = [self.sweep / "report" / name for name in FILES] + [path.with_name("metrics.json") for path in weights]
        # The header of weights names the commit, and work may go on while this runs.
        return {str(path): digest(path) for path in paths} | {
            str(path): digest(path, after_header=True) for path in weights
        }

    def disturbed(self, faults: int) -> dict[str, str]:
        """A sweep that is disturbed until it is finished, or until there were so many faults."""
        self.finished.clear()
        ended = False
        while not ended:
            start, began, since = self.start(), time.monotonic(), time.time()
            if self.chance.random() < 0.9:  # else while it starts
                while self.starts and not self.at_work(since):
                    self.pause(0.2)
            while self.starts:
                self.pause(self.chance.uniform(0, 2 * self.job_seconds))
                if not all(start.killed for start in self.starts) and sum(self.counts.values()) < faults:
                    kinds = {
                        kind: often for kind, often in self.kinds.items() if kind != "second" or len(self.starts) == 1
                    }
                    self.fault(self.chance.choices([*kinds], [*kinds.values()])[0], time.monotonic() - began)
            ended = start.process.exitcode == 0
        self.look()
        assert len(self.finished) == self.jobs, (
            f"{self.jobs - len(self.finished)} jobs are missing from a sweep that ended well"
        )
        return self.results()


def files(folder: Path) -> dict[str, tuple[str, int, int]]:
    """Content, inode and time of every file."""
    paths = [path for path in folder.rglob("*") if path.is_file() and path.name != ".lock"]
    return {
        str(path.relative_to(folder)): (digest(path), path.stat().st_ino, path.stat().st_mtime_ns) for path in paths
    }


def digest(path: Path, after_header: bool = False) -> str:
    """The hash of a file, or of what follows the header of one of weights."""
    content = path.read_bytes()
    return hashlib.md5(content[8 + int.from_bytes(content[:8], "little") :] if after_header else content).hexdigest()


def main() -> None:
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--faults", type=int, default=200)
    words.add_argument("--launcher", choices=LAUNCHERS, default="joblib")
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--seeds", default="0,1,2", help="of the sweep, which has four jobs for each")
    words.add_argument("--out", type=Path, required=True)
    given = words.parse_args()
    trial = Trial(given.out, given.launcher, given.seed, given.seeds)
    began, sweeps = time.monotonic(), 0
    try:
        expected = trial.whole()
        while sum(trial.counts.values()) < given.faults:
            shutil.rmtree(trial.sweep)
            now = trial.disturbed(given.faults)
            different = [name for name in expected if now[name] != expected[name]]
            assert not different, f"other bytes than those of an undisturbed sweep: {', '.join(different)}"
            sweeps += 1
            trial.log(f"sweep {sweeps} is finished, with the same bytes")
    finally:
        trial.close()
        minutes = (time.monotonic() - began) / 60
        lines = [
            f"{sweeps} sweeps of {trial.jobs} jobs, {given.launcher}, seed {given.seed}, lease {LEASE} s, "
            f"{trial.number} starts, {minutes:.0f} minutes",
            ", ".join(f"{kind}: {count}" for kind, count in sorted(trial.counts.items())),
            *(f"{count} x {line}" for line, count in trial.told.most_common()),
        ]
        sys.stdout.write("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
