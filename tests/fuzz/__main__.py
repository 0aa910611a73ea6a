"""Damage valid inputs of every command and watch it end: ``python -m fuzz --inputs 2000 --seed 0``.

A warm process forks for each input. What must not happen: a traceback, a crash, an end other than 0, 1 or 2, more than
``--seconds``, and after an error a file that was not there before, or that is another now.
"""

import argparse
import faulthandler
import hashlib
import os
import random
import resource
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "study"))

import forked
from fuzz.kept import KEPT
from fuzz.mutators import mutate
from fuzz.seeds import Case, write

MEMORY = 8 << 30


def run(case: Case, folder: Path, seconds: float) -> tuple[str, str]:
    """Run a case's command in a folder, in a process of its own; returns a verdict and what it said.

    The verdict is empty where nothing is wrong.
    """
    said = folder.with_suffix(".txt")
    before = _state(folder)
    child = forked.start(case.words, folder, said, dict(case.environment), {resource.RLIMIT_AS: MEMORY})
    code = forked.ended(child, seconds)
    text = said.read_text(errors="replace") if said.is_file() else ""
    if code is None:
        return "hang", text
    if "Traceback (most recent call last)" in text:
        return "traceback", text
    if code not in (0, 1, 2):
        return f"end {code}", text
    failed = code == 2
    if failed and not any(line.startswith("anystyle: error: ") for line in text.splitlines()):
        return "silent", text
    if failed and _state(folder) != before:
        changed = {name for name, _ in _state(folder) ^ before}
        return f"left {sorted(changed)[:3]}", text
    return "", text


def _state(folder: Path) -> set[tuple[str, str]]:
    """Every file with a hash of its content; locks may stay."""
    state = set()
    for path in folder.rglob("*"):
        regular = path.is_file() and not path.is_symlink() and os.access(path, os.R_OK)
        if path.name not in (".lock", "__pycache__") and path.suffix != ".pyc":
            state.add((str(path.relative_to(folder)), hashlib.md5(path.read_bytes()).hexdigest() if regular else ""))
    return state


def fuzz(inputs: int, seed: int, seconds: float, keep: Path, only: str = "") -> Counter[str]:
    """Run so many inputs; those that end badly are kept as folders with what was said. Returns verdicts and counts."""
    verdicts: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as root:
        cases = {name: case for name, case in write(Path(root) / "seeds").items() if case.files and only in name}
        forked.warm()
        for name, case in cases.items():
            verdict, said = run(case, _copied(Path(root), name), 120)
            if verdict or "anystyle: error" in said:
                print(f"the undamaged case {name} ends badly: {verdict}\n{said[-600:]}")
        start = time.monotonic()
        for number in range(inputs):
            draw = random.Random(f"{seed} {number}")
            (name,) = draw.choices(list(cases), [case.weight for case in cases.values()])
            folder = _copied(Path(root), name)
            file = draw.choice([name for name in cases[name].files if (folder / name).is_file()])
            how = mutate(draw, folder / file)
            verdict, said = run(cases[name], folder, seconds)
            verdicts[verdict.partition(" ")[0] or "fine"] += 1
            if verdict:
                kept = keep / f"{verdict.partition(' ')[0]}-{seed}-{number}"
                shutil.rmtree(kept, ignore_errors=True)
                _keep(folder, file, kept)
                (kept / "said.txt").write_text(f"{name}: {file} ({how}), {verdict}\n{said}")
                last = next((line for line in reversed(said.splitlines()) if line.strip()), "")
                print(f"{number} {name}: {file} ({how}): {verdict}: {last[:160]}", flush=True)
        print(f"{inputs} inputs in {time.monotonic() - start:.0f} s: {dict(verdicts)}")
    return verdicts


def again(seconds: float) -> int:
    """Run what once ended badly; returns how many end badly now."""
    badly = 0
    with tempfile.TemporaryDirectory() as root:
        cases = write(Path(root) / "seeds")
        forked.warm()
        for name, file, content in KEPT:
            folder = _copied(Path(root), name)
            (folder / file).unlink()
            (folder / file).write_bytes(content)
            verdict, said = run(cases[name], folder, seconds)
            badly += bool(verdict)
            print(f"{name}: {file} {content[:40]!r}: {verdict or 'fine'} {said[-800:] if verdict else ''}")
    return badly


def _keep(folder: Path, file: str, kept: Path) -> None:
    kept.mkdir(parents=True)
    path = folder / file
    if path.is_file() and not path.is_symlink() and os.access(path, os.R_OK):
        shutil.copyfile(path, kept / Path(file).name)


def _copied(root: Path, name: str) -> Path:
    folder = root / "input"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(root / "seeds" / name, folder)
    return folder


def main() -> int:
    """Run from the command line; the exit status is 0 where nothing was wrong."""
    words = argparse.ArgumentParser(prog="python -m fuzz", description=__doc__)
    words.add_argument("--inputs", type=int, default=2000)
    words.add_argument("--seed", type=int, default=0)
    words.add_argument("--seconds", type=float, default=30, help="after which a command hangs")
    words.add_argument("--keep", type=Path, default=Path("out/fuzz"), help="where inputs go that end badly")
    words.add_argument("--kept", action="store_true", help="instead, what once ended badly")
    words.add_argument("--only", default="", help="cases with this in their name")
    arguments = words.parse_args()
    faulthandler.enable()
    if arguments.kept:
        return int(again(arguments.seconds) > 0)
    verdicts = fuzz(arguments.inputs, arguments.seed, arguments.seconds, arguments.keep, arguments.only)
    return int(set(verdicts) != {"fine"})


if __name__ == "__main__":
    sys.exit(main())
