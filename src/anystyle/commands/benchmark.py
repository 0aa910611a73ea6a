"""What this machine does: encode, single pass, restyle, renderers and memory, in one table."""

import argparse
import json
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import torch

import anystyle
from anystyle.commands._flags import new_parser, split
from anystyle.commands._run import run, words_of
from anystyle.documents import read_json
from anystyle.inference import memory
from anystyle.inference.assemble import default_device, make_method
from anystyle.io.atomic import atomic_path
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.stylizer import Stylizer
from anystyle.types import Gaussians, Scene, Style, StyleEmbedding, Views

RENDERERS = ("cpu", "torch", "gsplat")
MEASURE_MEMORY = "--memory-of"
METHOD_WORDS = ("method=", "method.", "loss=", "loss.")
ATTRIBUTES = ("means", "rotations", "scales", "opacities", "harmonics")


@dataclass(frozen=True)
class Measured:
    """One row.

    Args:
        name: What was done.
        seconds: Wall clock, the best of the repeats.
        cpu_seconds: Of the process, in that repeat.
        instead: What it stands beside, and how they compare.
    """

    name: str
    seconds: float
    cpu_seconds: float
    instead: str = ""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle benchmark``; every other word is an override of the model's configuration."""
    flags = new_parser(
        "benchmark",
        "Measure this machine. model=NAME chooses a model, weights=... its weights, method=NAME a method "
        "that is measured beside the single pass; all as for stylize.",
    )
    flags.add_argument("--views", default="2,4,8", help="numbers of views (default: %(default)s)")
    flags.add_argument("--size", default=None, metavar="HxW", help="of a view (default: the model's, square)")
    flags.add_argument("--repeat", type=int, default=2, help="times, of which the best counts (default: %(default)s)")
    flags.add_argument("--out", default="benchmark.json", help="the results; rows in it are not measured again")
    flags.add_argument(MEASURE_MEMORY, type=int, default=None, help=argparse.SUPPRESS)
    return flags


def timed(function: Callable[[], object], device: torch.device) -> tuple[float, float]:
    """Wall-clock and CPU seconds of one run."""
    _wait(device)
    wall, cpu = time.perf_counter(), time.process_time()
    function()
    _wait(device)
    return time.perf_counter() - wall, time.process_time() - cpu


def best(function: Callable[[], object], repeat: int, device: torch.device) -> tuple[float, float]:
    """Wall-clock and CPU seconds of the fastest of some runs."""
    return min(timed(function, device) for _ in range(repeat))


def _wait(device: torch.device) -> None:
    if device.type == "cuda":
        torch.cuda.synchronize()


@dataclass(frozen=True)
class Case:
    """A model with views to run on."""

    stylizer: Stylizer
    views: Views
    style: StyleEmbedding

    @property
    def device(self) -> torch.device:
        """Where it runs."""
        return self.views.images.device

    def encode(self) -> Scene:
        """Encode the views."""
        return self.stylizer.encode(self.views)

    def restyle(self, scene: Scene) -> Gaussians:
        """Style an encoded scene."""
        with torch.no_grad():
            return self.stylizer.restyle(scene, self.style)

    def single_pass(self) -> Gaussians:
        """All of it at once, as for one style."""
        with torch.no_grad():
            return self.stylizer(self.views, self.style)


def load(words: Sequence[str], views: int, size: tuple[int, int] | None) -> Case:
    """Build a model with random views and a random style, on a CUDA device if there is one."""
    model = next((word.partition("=")[2] for word in words if word.startswith("model=")), None)
    others = [word for word in words if not word.startswith("model=")]
    device = default_device()
    stylizer = anystyle.load(model, others).to(device)
    backbone = stylizer.backbone
    side = backbone.resolution // backbone.patch_size * backbone.patch_size
    generator = torch.Generator().manual_seed(0)
    images = torch.rand(1, views, 3, *(size or (side, side)), generator=generator)
    vector = torch.nn.functional.normalize(torch.randn(1, stylizer.style_encoder.dim, generator=generator), dim=-1)
    return Case(stylizer, Views(images.to(device)), StyleEmbedding(vector, vector).to(device))


def passes(case: Case, repeat: int) -> list[Measured]:
    """Encode, restyle and single pass, one after the other as often as asked for, so that a slow hour meets all."""
    latest: dict[str, Any] = {}
    times: dict[str, list[tuple[float, float]]] = {"encode": [], "restyle": [], "single": []}
    works: dict[str, Callable[[], object]] = {
        "encode": case.encode,
        "restyle": lambda: case.restyle(latest["encode"]),
        "single": case.single_pass,
    }
    for _ in range(repeat):
        for name, work in works.items():
            latest.pop(name, None)
            times[name].append(timed(lambda work=work, name=name: latest.update({name: work()}), case.device))
    encode, restyle, single = (min(seconds) for seconds in times.values())
    same = all(torch.equal(getattr(latest["restyle"], name), getattr(latest["single"], name)) for name in ATTRIBUTES)
    fraction = restyle[1] / max(single[1], 1e-9)
    ratio = f"{fraction:.3f} of the single pass's CPU time; results {'equal' if same else 'DIFFER'}"
    return [
        Measured("encode", *encode, "once a scene"),
        Measured("single pass", *single, "what the published code pays for every style"),
        Measured("restyle", *restyle, ratio),
    ]


def methods(case: Case, words: Sequence[str]) -> list[Measured]:
    """A method on the scene, once, with a picture of noise for a style."""
    method = make_method(compose("stylize", list(words)), case.stylizer.style_encoder)
    scene = case.encode()
    style = Style(image=torch.rand(1, 3, *scene.cameras.size, generator=torch.Generator().manual_seed(0)))
    style = style.to(case.device)
    seconds = timed(lambda: method(case.stylizer, scene, style, case.style), case.device)
    return [Measured(" ".join(words), *seconds, "a style by this method, once the scene is encoded")]


def renderers(case: Case, repeat: int) -> list[Measured]:
    """Every renderer that this machine can run, on one view of the scene."""
    scene = case.encode()
    gaussians, camera = case.restyle(scene), scene.cameras.select([0])
    rows: list[Measured] = []
    for name in RENDERERS:
        if name == "gsplat" and (find_spec("gsplat") is None or case.device.type != "cuda"):
            continue
        if name == "cpu" and case.device.type != "cpu":
            continue
        renderer: Any = catalog().find("renderer", name).load()()
        with torch.no_grad():
            renderer(gaussians, camera)
            seconds = best(lambda draw=renderer: draw(gaussians, camera), repeat, case.device)
        first = rows[0].seconds if rows else seconds[0]
        rows.append(Measured(f"render with {name}", *seconds, f"{seconds[0] / first:.1f} x the first renderer"))
    return rows


def peak_memory(words: Sequence[str], views: int, size: str | None) -> int:
    """Peak bytes of a process that encodes and styles so many views once."""
    command = [sys.executable, "-m", "anystyle.commands.benchmark", MEASURE_MEMORY, str(views), *words]
    done = subprocess.run([*command, *(["--size", size] if size else [])], capture_output=True, text=True, check=False)
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1] if done.stderr.strip() else "out of memory")
    return int(done.stdout.split()[-1])


def own_peak(make: Callable[[], Case]) -> int:
    """Peak bytes of building a case, encoding it and styling it once: of the graphics card, or of the process."""

    def work() -> None:
        case = make()
        case.restyle(case.encode())

    if torch.cuda.is_available():
        work()
        return torch.cuda.max_memory_allocated()
    return memory.sampled_peak(work)


def slope(peaks: Mapping[int, int]) -> float:
    """Bytes a view, by least squares."""
    return float(np.polyfit(list(peaks), list(peaks.values()), 1)[0]) if len(peaks) > 1 else 0.0


def off_line(peaks: Mapping[int, int]) -> float:
    """The most bytes that a peak lies beside the line through all of them."""
    line = np.polyfit(list(peaks), list(peaks.values()), 1)
    return float(np.abs(np.polyval(line, list(peaks)) - list(peaks.values())).max())


class _Stored(msgspec.Struct):
    setting: dict[str, Any]
    rows: dict[str, list[dict[str, float | str | None]]]


class Results:
    """A JSON file of rows that is written after each, and read where an earlier run stopped."""

    def __init__(self, path: Path, setting: Mapping[str, Any]) -> None:
        self.path = path
        self.content: dict[str, Any] = {"setting": dict(setting), "rows": {}}
        if path.is_file():
            stored: _Stored = read_json(path, _Stored, what="benchmark; remove it or give another --out")
            if stored.setting == self.content["setting"]:
                self.content = {"setting": stored.setting, "rows": stored.rows}

    def get(self, group: str, measure: Callable[[], list[Measured]]) -> list[dict[str, Any]]:
        """Rows of a group, measured now unless they are there."""
        if group not in self.content["rows"]:
            print(f"{group} …", file=sys.stderr, flush=True)
            self.content["rows"][group] = [vars(row) for row in measure()]
            with atomic_path(self.path) as temporary:
                temporary.write_text(json.dumps(self.content, indent=2) + "\n")
        return self.content["rows"][group]


def benchmark(words: Sequence[str]) -> None:
    """Run the command."""
    arguments, overrides = split(parser(), words)
    size = _size(arguments.size)
    if arguments.memory_of is not None:
        print(own_peak(lambda: load(overrides, arguments.memory_of, size)))
        return
    counts = _counts(arguments.views)
    if arguments.repeat < 1:
        raise ValueError(f"--repeat is {arguments.repeat}; measure at least once")
    setting = {
        "machine": platform.processor() or platform.machine(),
        "threads": torch.get_num_threads(),
        "versions": {name: version(name) for name in ("anystyle", "torch")},
        "overrides": list(overrides),
        "size": arguments.size,
        "views": counts,
        "repeat": arguments.repeat,
    }
    chosen = [word for word in overrides if word.startswith(METHOD_WORDS)]
    overrides = [word for word in overrides if word not in chosen]
    results = Results(Path(arguments.out), setting)
    label = f"{counts[0]} views"
    measured = results.get(label, lambda: passes(load(overrides, counts[0], size), arguments.repeat))
    rows = [row | {"name": f"{row['name']} ({label})"} for row in measured]
    rows += results.get("renderers", lambda: renderers(load(overrides, counts[0], size), arguments.repeat))
    if chosen:
        rows += results.get("method", lambda: methods(load(overrides, counts[0], size), chosen))
    peaks: dict[int, int] = {}
    for count in counts:
        label = f"memory of {count} views"

        def measure(count: int = count) -> list[Measured]:
            bytes_ = peak_memory(overrides, count, arguments.size)
            return [Measured(f"peak memory of {count} views", 0.0, 0.0, str(bytes_))]

        peaks[count] = int(results.get(label, measure)[0]["instead"])
    print(table(rows, peaks))
    print(f"in {arguments.out}")


def table(rows: Sequence[Mapping[str, Any]], peaks: Mapping[int, int]) -> str:
    """The table that people read."""
    lines = ["| what | seconds | CPU seconds | beside |", "|---|---|---|---|"]
    lines += [f"| {row['name']} | {row['seconds']:.3f} | {row['cpu_seconds']:.3f} | {row['instead']} |" for row in rows]
    lines += ["", "| views | peak memory |", "|---|---|"]
    lines += [f"| {views} | {size / 2**20:.0f} MiB |" for views, size in peaks.items()]
    growth = f"\nMemory grows by {slope(peaks) / 2**20:.1f} MiB a view"
    beside = f"; the measured peaks lie within {off_line(peaks) / 2**20:.1f} MiB of that line" if len(peaks) > 2 else ""
    lines.append(f"{growth}{beside}.")
    free = memory.available(torch.device("cpu"))
    if free is not None:
        lines.append(f"{free / 2**30:.1f} GiB are free on this machine.")
    return "\n".join(lines)


def _counts(text: str) -> list[int]:
    try:
        counts = [int(word) for word in text.split(",")]
    except ValueError:
        raise ValueError(f"--views takes numbers such as 2,4,8, not {text!r}") from None
    if min(counts) < 1:
        raise ValueError(f"--views takes numbers of at least 1, not {text}")
    return counts


def _size(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    height, cross, width = text.partition("x")
    if not (cross and height.isdigit() and width.isdigit()):
        raise ValueError(f"--size takes height and width such as 224x448, not {text!r}")
    return int(height), int(width)


if __name__ == "__main__":
    run(lambda: benchmark(words_of(None)))
