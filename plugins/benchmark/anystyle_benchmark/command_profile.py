"""``anystyle profile``: encoding, single pass, restyling, renderers and memory of this machine, in one table."""

import argparse
import platform
import re
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from importlib.metadata import version
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.utils import _pytree as pytree

import anystyle
from anystyle.cli.arguments import new_parser, split
from anystyle.contracts import Command, Renderer
from anystyle.errors import UserError
from anystyle.io.atomic import write_json
from anystyle.pipeline import memory
from anystyle.pipeline.load import default_device, make_method, weights_file
from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.compose import compose
from anystyle.types import Style, StyleEmbedding, Views
from anystyle.vision.weights import MissingWeights


class Measured(NamedTuple):
    """One row: what was run, seconds of wall clock and of the process in the fastest repeat, and a remark."""

    name: str
    seconds: float
    cpu_seconds: float
    note: str = ""


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle profile``; every other argument is an override of the model's configuration."""
    flags = new_parser(
        "profile",
        "Measure this machine. model=NAME chooses a model, weights=... its weights, method=NAME a method "
        "that is measured beside the single pass; all as for stylize.",
    )
    flags.add_argument("--views", default="2,4,8", help="numbers of views (default: %(default)s)")
    flags.add_argument("--size", metavar="HxW", help="size of a view (default: the model's, square)")
    flags.add_argument("--repeat", type=int, default=2, help="runs, of which the fastest counts (default: %(default)s)")
    flags.add_argument("--out", default="profile.json", help="the results as JSON (default: %(default)s)")
    return flags


class Profile(Command):
    """Measure this machine: encoding, single pass, restyling, renderers and memory, in one table."""

    def __call__(self, words: Sequence[str]) -> None:
        arguments, overrides = split(parser(), words)
        matched = re.fullmatch(r"(\d+)x(\d+)", arguments.size or "0x0")
        if matched is None:
            raise UserError(f"--size takes height and width such as 224x448, not {arguments.size!r}")
        size = (int(matched[1]), int(matched[2])) if arguments.size else None
        counts = [int(word) if word.strip().isdecimal() else 0 for word in arguments.views.split(",")]
        if min(counts) < 1:
            raise UserError(f"--views takes numbers of at least 1 such as 2,4,8, not {arguments.views!r}")
        if arguments.repeat < 1:
            raise UserError(f"--repeat is {arguments.repeat}; measure at least once")
        of_method = [word for word in overrides if word.startswith(("method=", "method.", "loss=", "loss."))]
        case = Case([word for word in overrides if word not in of_method], size)
        print(f"{counts[0]} views …", file=sys.stderr, flush=True)
        views = case.views(counts[0])
        rows = [*case.passes(views, arguments.repeat), *case.renderers(views, arguments.repeat)]
        rows += [case.method(views, of_method)] if of_method else []
        peaks = {count: case.peak_memory(case.views(count)) for count in counts}
        setting = {
            "machine": platform.processor() or platform.machine(),
            "threads": torch.get_num_threads(),
            "versions": {name: version(name) for name in ("anystyle", "torch")},
            "overrides": overrides,
            "size": arguments.size,
            "views": counts[0],
            "repeat": arguments.repeat,
        }
        document = {"setting": setting, "rows": [row._asdict() for row in rows]}
        write_json(arguments.out, document | {"peaks": {str(count): peak for count, peak in peaks.items()}})
        print(f"{counts[0]} views:\n\n{table(rows, peaks)}\nin {arguments.out}")


class Case:
    """A model with a random style and random views, on a CUDA device if there is one."""

    def __init__(self, words: Sequence[str], size: tuple[int, int] | None) -> None:
        self.device = default_device()
        self.stylizer = anystyle.load(None, [*words, *without_missing(words)]).to(self.device)
        backbone = self.stylizer.backbone
        side = backbone.resolution // backbone.patch_size * backbone.patch_size
        self.size = size or (side, side)
        with torch.no_grad():
            vector, tokens = self.stylizer.vectors_and_tokens(self.views(1).images[:, 0])
        # Normalised in place of the direction from a neutral text, for which a vocabulary may be missing.
        self.style = StyleEmbedding(vector, torch.nn.functional.normalize(vector, dim=-1), tokens=tokens)

    def views(self, number: int) -> Views:
        """So many random views."""
        images = torch.rand(1, number, 3, *self.size, generator=torch.Generator().manual_seed(0))
        return Views(images.to(self.device))

    @torch.no_grad()
    def passes(self, views: Views, repeat: int) -> list[Measured]:
        """Encode, restyle and single pass in turn, so that a slow moment of the machine affects all of them."""
        latest: dict[str, Any] = {}
        works: dict[str, Callable[[], object]] = {
            "encode": lambda: self.stylizer.encode(views),
            "restyle": lambda: self.stylizer.restyle(latest["encode"], self.style),
            "single": lambda: self.stylizer(views, self.style),
        }
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
        for _ in range(repeat):
            for name, work in works.items():
                latest.pop(name, None)
                times[name].append(timed(lambda work=work, name=name: latest.update({name: work()})))
        encode, restyle, single = (min(seconds) for seconds in times.values())
        restyled, passed = (pytree.tree_leaves(latest[name]) for name in ("restyle", "single"))
        ratio = restyle[1] / max(single[1], 1e-9)
        note = f"{ratio:.3f} of the single pass's CPU time; results {agreement(restyled, passed)}"
        return [
            Measured("encode", *encode, "once per scene"),
            Measured("single pass", *single, "what the published code pays for every style"),
            Measured("restyle", *restyle, note),
        ]

    def method(self, views: Views, words: Sequence[str]) -> Measured:
        """A method on the encoded scene, once, with an image of noise as the style."""
        method = make_method(compose("stylize", list(words)), self.stylizer.style_encoder)
        scene, style = self.stylizer.encode(views), Style(image=views.images[:, 0])
        seconds = timed(lambda: method(self.stylizer, scene, style, self.style))
        return Measured(" ".join(words), *seconds, "a style by this method, once the scene is encoded")

    @torch.no_grad()
    def renderers(self, views: Views, repeat: int) -> list[Measured]:
        """Every renderer of the catalog that runs on this machine, on one view of the scene."""
        scene = self.stylizer.encode(views)
        gaussians, camera = self.stylizer.restyle(scene, self.style), scene.cameras.select([0])
        rows: list[Measured] = []
        for name in catalog().names("renderer"):
            renderer = build(Renderer, name)
            try:
                renderer(gaussians, camera)
            except (ImportError, UserError) as error:  # not installed, or for another device
                print(f"renderer {name} is left out: {error}", file=sys.stderr)
                continue
            seconds = min(timed(lambda renderer=renderer: renderer(gaussians, camera)) for _ in range(repeat))
            first = rows[0].seconds if rows else seconds[0]
            rows.append(Measured(f"render with {name}", *seconds, f"{seconds[0] / first:.1f} x the first renderer"))
        return rows

    @torch.no_grad()
    def peak_memory(self, views: Views) -> int:
        """Peak bytes of tensors, the weights among them, while views are encoded and styled."""

        def single_pass() -> object:
            return self.stylizer.restyle(self.stylizer.encode(views), self.style)

        if self.device.type == "cuda":
            torch.cuda.reset_peak_memory_stats()
            single_pass()
            return torch.cuda.max_memory_allocated()
        weights = list(self.stylizer.state_dict().values())
        return memory.peak(single_pass, weights) + sum(weight.nbytes for weight in weights)


def agreement(results: Sequence[Tensor], others: Sequence[Tensor]) -> str:
    """Whether two lists of tensors are equal, or by how much they differ: sums over voxels have no fixed order on CUDA.

    Example:
        >>> agreement([torch.tensor([1.0, 2.0])], [torch.tensor([1.0, 2.5])])
        'differ by 2e-01 of the largest value'
    """
    pairs = list(zip(results, others, strict=True))
    if all(torch.equal(one, other) for one, other in pairs):
        return "equal"
    if any(one.shape != other.shape for one, other in pairs):
        return "DIFFER in number"
    worst = max(float((one - other).abs().max() / other.abs().max().clamp_min(1e-12)) for one, other in pairs)
    return f"differ by {worst:.0e} of the largest value"


def timed(function: Callable[[], object]) -> tuple[float, float]:
    """Wall-clock and CPU seconds of one run."""
    clocks = []
    for work in (lambda: None, function):
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        clocks.append((time.perf_counter(), time.process_time()))
    return clocks[1][0] - clocks[0][0], clocks[1][1] - clocks[0][1]


def without_missing(words: Sequence[str]) -> list[str]:
    """The words that leave the parts as initialised whose weights are not on this machine: a pass costs the same."""
    missing: list[str] = []
    for part, name in compose("stylize", list(words)).weights.items():
        try:
            if name is not None:
                weights_file(name)
        except MissingWeights:
            print(f"the weights '{name}' are missing: the {part} is profiled as initialised", file=sys.stderr)
            missing.append(f"weights.{part}=null")
    return missing


def table(rows: Sequence[Measured], peaks: Mapping[int, int]) -> str:
    """The Markdown tables of times and of peak bytes by number of views."""
    lines = ["| what | seconds | CPU seconds | note |", "|---|---|---|---|"]
    lines += [f"| {row.name} | {row.seconds:.3f} | {row.cpu_seconds:.3f} | {row.note} |" for row in rows]
    lines += ["", "| views | peak memory of tensors |", "|---|---|"]
    lines += [f"| {views} | {size / 2**20:.0f} MiB |" for views, size in peaks.items()]
    if len(peaks) > 1:
        slope = np.polyfit(list(peaks), list(peaks.values()), 1)[0] / 2**20
        lines.append(f"\nMemory grows by {slope:.1f} MiB per view.")
    return "\n".join(lines)
