"""An evaluation that is killed at any moment, and started again, ends with the same scores and pictures."""

import hashlib
import json
import os
import random
import signal
import time

import numpy as np
import pytest

from tests.support.pictures import save
from tests.support.processes import command

pytestmark = pytest.mark.slow
WORDS = ("evaluate", "--content", "content", "--style", "style", "--stylized", "stylized", "--out", "out")


def picture(path, seed):
    save(path, np.random.default_rng(seed).integers(0, 255, (240, 320, 3), np.uint8))


def write_images(folder):
    for scene in range(6):
        for frame in range(2):
            picture(folder / "content" / f"s{scene}" / f"{frame}.png", scene)
            picture(folder / "stylized" / f"s{scene}" / f"ink_{frame}.png", 9 + scene)
    picture(folder / "style" / "ink.png", 0)


def ended(process, seconds):
    """The exit status, negative after a signal; ``None`` if it runs longer, and then it is killed."""
    process.join(seconds)
    status = process.exitcode
    process.kill()
    process.join()
    return status


def results(out):
    """Hashes of pictures and tables, and the scores."""
    files = [path for path in out.rglob("*") if path.suffix in (".png", ".csv") and "spread" not in path.name]
    scores = json.loads((out / "metrics.json").read_text())
    del scores["provenance"]  # has times
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files} | scores


def test_a_killed_evaluation_is_continued_to_the_same_result(tmp_path):
    for name in ("whole", "killed", "terminated"):
        write_images(tmp_path / name)

    def begin(name):
        words = (*WORDS, "metric=[psnr,ssim,color_match]")
        return command(words, tmp_path / name, tmp_path / f"{name}.txt", {"ANYSTYLE_CACHE": "cache"})

    start = time.monotonic()
    assert ended(begin("whole"), 300) == 0, (tmp_path / "whole.txt").read_text()
    seconds, expected = time.monotonic() - start, results(tmp_path / "whole" / "out")
    draw = random.Random(0)
    for name, number in (("killed", signal.SIGKILL), ("terminated", signal.SIGTERM)):
        for _ in range(3):
            process = begin(name)
            time.sleep(draw.uniform(0, seconds))
            if process.is_alive() and process.pid is not None:
                os.kill(process.pid, number)
            assert ended(process, 60) in (0, -number, 128 + number)
        output = (tmp_path / f"{name}.txt").read_text()
        assert "Traceback" not in output, output
        assert ended(begin(name), 300) == 0, (tmp_path / f"{name}.txt").read_text()
        assert results(tmp_path / name / "out") == expected
