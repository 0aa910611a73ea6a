"""Damaged inputs end a command in one line, and faults while it works lose nothing.

``FUZZ_INPUTS=50000 FUZZ_SEED=1`` sets how many inputs are damaged, and which.
"""

import hashlib
import json
import os
import random
import shutil
import signal
import time
from dataclasses import replace

import pytest

from tests.support.fuzz_inputs import MUTATORS, REGRESSIONS, option, picture, rename, write
from tests.support.processes import command
from tests.support.training_cases import RECONSTRUCTION

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def cases(tmp_path_factory):
    folder = tmp_path_factory.mktemp("seeds")
    return folder, write(folder)


def state(folder):
    """Every file with a hash of its content, locks and bytecode excepted."""
    files = (path for path in folder.rglob("*") if path.is_file() and path.name != ".lock" and path.suffix != ".pyc")
    return {str(path.relative_to(folder)): hashlib.md5(path.read_bytes()).hexdigest() for path in files}


def ended(process, seconds):
    """The exit status, negative after a signal; ``None`` if it runs longer, and then it is killed."""
    process.join(seconds)
    status = process.exitcode
    process.kill()
    process.join()
    return status


def problem(case, folder):
    """How a command ends badly; empty if it ends well, or in one line and without leaving anything."""
    before, output = state(folder), folder.with_suffix(".txt")
    code = ended(command(case.words, folder, output, case.environment), 120)
    text = output.read_text(errors="replace")
    if code not in (0, 1, 2) or "Traceback (most recent call last)" in text:
        return f"ends with {code}: {text[-600:]}"
    if code == 2 and not any(line.startswith("anystyle: error: ") for line in text.splitlines()):
        return f"says nothing: {text[-600:]}"
    return f"leaves {state(folder).items() ^ before.items()}" if code == 2 and state(folder) != before else ""


def copied(seeds, name, tmp_path):
    shutil.rmtree(tmp_path / "case", ignore_errors=True)
    return shutil.copytree(seeds / name, tmp_path / "case")


def test_valid_inputs_are_read(cases, tmp_path):
    seeds, known = cases
    for name, case in known.items():
        folder = copied(seeds, name, tmp_path)
        assert problem(case, folder) == "", name
        assert "anystyle: error" not in folder.with_suffix(".txt").read_text(), name


@pytest.mark.parametrize(("name", "file", "content"), REGRESSIONS)
def test_inputs_that_once_ended_badly_end_well(cases, tmp_path, name, file, content):
    folder = copied(cases[0], name, tmp_path)
    (folder / file).write_bytes(content)
    assert problem(cases[1][name], folder) == ""


@pytest.mark.filterwarnings("ignore:torch.quantize_per_tensor:UserWarning")  # a mutation makes such a tensor
def test_damaged_inputs_end_well(cases, tmp_path):
    seeds, known = cases
    problems = []
    for number in range(int(os.environ.get("FUZZ_INPUTS", "300"))):
        draw = random.Random(f"{os.environ.get('FUZZ_SEED', '0')} {number}")
        name = draw.choice(list(known))
        folder = copied(seeds, name, tmp_path)
        case, what = known[name], "option"
        if not case.files:
            case = replace(case, words=option(draw, case.words))
            what = case.words[-1]
        else:
            path = folder / draw.choice(case.files)
            mutate = draw.choice((*MUTATORS, None))
            what = f"{path.name} {mutate.__name__ if mutate else 'rename'}"
            if mutate is None:
                rename(draw, path)
            else:
                path.write_bytes(mutate(draw, path.read_bytes(), path.suffix))
        if found := problem(case, folder):
            shutil.copytree(folder, tmp_path / f"kept-{number}", symlinks=True)
            problems.append(f"{number} {name} {what}: {found}")
    assert not problems, "\n".join(problems)


# Faults


def train(folder):
    words = [word for word in RECONSTRUCTION if "max_steps" not in word]
    more = ("checkpoint.every_steps=1", "average=0.9", "export.half=false", "trainer.max_steps=12")
    return ("train", *words, *more), folder / "runs" / "test"


def evaluate(folder):
    for scene in range(6):
        for frame in range(2):
            picture(folder / "content" / f"s{scene}" / f"{frame}.png", scene, (320, 240))
            picture(folder / "stylized" / f"s{scene}" / f"ink_{frame}.png", 9 + scene, (320, 240))
    picture(folder / "style" / "ink.png")
    words = ["evaluate", "--content", "content", "--style", "style", "--stylized", "stylized", "--out", "out"]
    return (*words, "metric=[psnr,ssim,color_match]"), folder / "out"


def results(out):
    """Hashes of weights and pictures, and figures without times."""
    hashes = {name: digest for name, digest in state(out).items() if name.endswith((".safetensors", ".png", ".csv"))}
    figures = json.loads((out / "metrics.json").read_text())
    return {name: digest for name, digest in hashes.items() if "log" not in name and "spread" not in name} | {
        name: figure for name, figure in figures.items() if name not in ("provenance", "train/seconds")
    }


@pytest.mark.parametrize("prepare", [train, evaluate])
def test_a_killed_run_is_continued_to_the_same_result(tmp_path, prepare):
    folders = {}
    for name in ("whole", "killed", "terminated"):
        (tmp_path / name).mkdir()
        folders[name] = (tmp_path / name, *prepare(tmp_path / name))

    def begin(name):
        folder, words, _ = folders[name]
        return command(words, folder, folder.with_suffix(".txt"), {"ANYSTYLE_CACHE": "cache"})

    start = time.monotonic()
    assert ended(begin("whole"), 300) == 0, (tmp_path / "whole.txt").read_text()
    seconds, expected = time.monotonic() - start, results(folders["whole"][2])
    draw = random.Random(0)
    for name, number in (("killed", signal.SIGKILL), ("terminated", signal.SIGTERM)):
        for _ in range(3):
            process = begin(name)
            time.sleep(draw.uniform(0, seconds))
            os.kill(process.pid, number)
            assert ended(process, 60) in (0, -number, 128 + number)
        output = (tmp_path / f"{name}.txt").read_text()
        assert "Traceback" not in output, output
        assert ended(begin(name), 300) == 0, (tmp_path / f"{name}.txt").read_text()
        assert results(folders[name][2]) == expected
