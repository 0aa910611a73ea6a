"""What the protocol of the paper's Table 2 costs beside the networks that it judges with.

``python -m tests.benchmarks.table2 [FRAMES [SIDE]]`` judges synthetic results, photographs mixed with each of 50 style
images in 4 scenes, and the photographs themselves in 50 styles, as ``anystyle evaluate protocol=table2`` does. The
networks have the published sizes and weights filled by a rule, which cost what the published ones cost. It prints CPU
seconds of reading and judging, of the networks' forward passes among them, and the calls that take most of the rest.
"""

import cProfile
import os
import pstats
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from PIL import Image, ImageOps

import anystyle
from anystyle.evaluation.paper_folder import NUM_STYLES, SCENES
from anystyle.evaluation.protocols import tables
from anystyle.vision.features import Frozen
from tests.benchmarks.distances import CAPTURES
from tests.support.judging_cases import filled_folder

STYLE_SIDE = 256


def write(root: Path, frames: int, side: int) -> None:
    """A folder as the paper's protocol reads it, of squares of a side, with the results of one method."""
    files = sorted(CAPTURES.rglob("*.jpg"))
    photographs = [ImageOps.fit(Image.open(path).convert("RGB"), (side, side)) for path in files]
    for folder in ("content", "styles", "methods/mixed"):
        (root / folder).mkdir(parents=True)
    for number in range(NUM_STYLES):
        style = ImageOps.fit(photographs[number % len(files)], (STYLE_SIDE, STYLE_SIDE))
        style = style if number < len(files) else ImageOps.invert(style)
        style.save(root / "styles" / f"{number:02d}.png")
        for place, scene in enumerate(SCENES):
            for frame in range(frames):
                photograph = photographs[(place * frames + frame) % len(files)]
                content = root / "content" / scene / f"{frame:03d}.png"
                content.parent.mkdir(exist_ok=True)
                photograph.save(content)
                result = root / "methods" / "mixed" / scene / f"{number:02d}" / content.name
                result.parent.mkdir(parents=True, exist_ok=True)
                Image.blend(photograph, style.resize((side, side)), 0.5).save(result)


class Clock:
    """CPU seconds inside of networks, and of all that is judged."""

    def __init__(self) -> None:
        self.networks, self.total, self.inside = 0.0, 0.0, False
        self.profile = cProfile.Profile(time.process_time)

    def of_networks(self, call: Callable[..., Any]) -> Callable[..., Any]:
        """A module's call, timed unless it is part of another one's."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            if self.inside:
                return call(*args, **kwargs)
            self.inside, start = True, time.process_time()
            result = call(*args, **kwargs)
            self.inside, self.networks = False, self.networks + time.process_time() - start
            return result

        return timed

    def around(self, judge: Callable[..., Any]) -> Callable[..., Any]:
        """The same function, timed."""

        def timed(*args: Any, **kwargs: Any) -> Any:
            start = time.process_time()
            if PROFILED:
                self.profile.enable()
            result = judge(*args, **kwargs)
            self.profile.disable()
            self.total += time.process_time() - start
            return result

        return timed


PROFILED = "ANYSTYLE_PROFILE" in os.environ


def main(frames: int = 1, side: int = 448) -> None:
    """Print the seconds."""
    torch.set_num_threads(1)
    os.environ["ANYSTYLE_WEIGHTS"] = str(filled_folder())
    clock = Clock()
    Frozen.__call__ = clock.of_networks(Frozen.__call__)
    tables.judge_pairing = clock.around(tables.judge_pairing)
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        write(root, frames, side)
        words = ["protocol=table2", f"root={root}", "protocol.guides=[]", f"protocol.frames={frames}"]
        words += [f"protocol.size={side}", "model=tiny"]
        evaluation = anystyle.evaluate(words, out=root / "out")
    rest = clock.total / clock.networks - 1
    taken = f"{clock.total:.1f} s, of which networks {clock.networks:.1f} s; the rest is {rest:.1%} of these"
    sys.stdout.write(f"{evaluation.n} images of {side} x {side} pixels: {taken}\n")
    if PROFILED:
        pstats.Stats(clock.profile).sort_stats("tottime").print_stats(30)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
