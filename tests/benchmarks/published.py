"""This implementation beside the published code, in one run: seconds, memory and equality of results.

``python -m tests.benchmarks.published head CHECKOUT`` takes a checkout of the network's repository, fills the published
network with hashed weights in fp32 and writes them as its checkpoint, which both networks load strictly, each in a
process of its own. They take turns on the CPU and never run at once. It prints a table and writes the scores as JSON.

The networks need ``pip install einops``; what is only imported, or cannot run on the CPU, is replaced
(``published_stand_ins.py``). Nothing is rendered. Seconds are of CPU time, memory is the largest resident set of each
process over all it does for a scene, with the weights, which both map from the same file.
"""

import argparse
import contextlib
import ctypes
import json
import multiprocessing
import os
import re
import statistics
import sys
import tempfile
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import torch
from scipy.spatial import cKDTree
from torch import Tensor
from torch.utils.flop_counter import FlopCounterMode

from anystyle.cli.run import run
from anystyle.errors import UserError
from anystyle.testing.oracle import fill_named, smooth_image
from anystyle.types import Scene
from tests.benchmarks import published_stand_ins
from tests.benchmarks.published_networks import NETWORKS, Network, views
from tests.support.oracle import golden

SAME = 1e-4
"""Gaussians of both are one another's where their centres are nearer than this; a voxel is 0.002 wide."""

Step = Callable[[Tensor, Tensor], Mapping[str, Tensor] | None]


@dataclass(frozen=True)
class Case:
    """What is measured: the published code and its variant, the file of both, and how many threads each has."""

    checkout: Path
    variant: str
    file: Path
    threads: int

    @property
    def network(self) -> Network:
        """The published network."""
        return NETWORKS[self.variant]


def fill(state: Mapping[str, Tensor], network: Network) -> None:
    """Hash the names and places of a published checkpoint into its tensors, as the goldens of the tests have them."""
    rules = golden(network.golden)["fill"]["rules"]
    for key, tensor in state.items():
        name = key.removeprefix(network.prefix)
        tensor.copy_(fill_named({name: tensor}, rules)[name])


def published(case: Case) -> dict[str, Step]:
    """The published network, which computes everything for every style."""
    published_stand_ins.install()
    sys.path.insert(0, str(case.checkout))
    network = case.network
    real = torch.bfloat16
    encoder, run_once = network.build(case.checkout)
    replaced, torch.bfloat16 = torch.bfloat16, real
    state = {network.prefix + name: tensor for name, tensor in encoder.state_dict().items()}
    fill(state, network)
    torch.save({"state_dict": state}, case.file)
    del state
    loaded = torch.load(case.file, mmap=True)["state_dict"]
    state = {name.removeprefix(network.prefix): tensor for name, tensor in loaded.items()}
    torch.bfloat16 = replaced
    encoder.load_state_dict(state, assign=True)
    encoder.eval()
    ctypes.CDLL(None).malloc_trim(0)  # what it was built with is not counted

    def single(images: Tensor, style: Tensor) -> dict[str, Tensor]:
        gaussians = run_once(images, style)
        names = ("means", "rotations", "scales", "opacities", "harmonics", "covariances")
        return {name: value[0] for name in names if (value := getattr(gaussians, name, None)) is not None}

    return {"single": single}


def ours(case: Case) -> dict[str, Step]:
    """This network, which encodes a scene once and then styles it."""
    network = case.network
    stylizer = network.load(case.file)
    encoded: list[Scene] = []

    def encode(images: Tensor, style: Tensor) -> None:
        encoded[:] = [stylizer.encode(views(images))]

    def restyle(images: Tensor, style: Tensor) -> Mapping[str, Tensor]:
        return network.fields(stylizer.restyle(encoded[0], network.embed(stylizer, style)))

    def single(images: Tensor, style: Tensor) -> None:
        encoded.clear()
        stylizer(views(images), network.embed(stylizer, style))

    def floor(images: Tensor, style: Tensor) -> Mapping[str, Tensor]:
        with FlopCounterMode(display=False) as counter:
            single(images, style)
        return {"seconds": torch.tensor(counter.get_total_flops() / products_a_second())}

    return {"single": single, "encode": encode, "style": restyle, "floor": floor}


def products_a_second() -> float:
    """Floating-point operations a second of CPU time in a large product of matrices, the best of five."""
    matrix, seconds = torch.ones(2048, 2048), []
    for _ in range(5):
        started = time.process_time()
        matrix @ matrix
        seconds.append(time.process_time() - started)
    return 2 * 2048**3 / min(seconds)


def work(build: Callable[[Case], dict[str, Step]], case: Case, pipe: Connection) -> None:
    """A process that holds one network: names of steps in, what they took out."""
    torch.set_num_threads(case.threads)
    warnings.simplefilter("ignore")
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere), torch.no_grad():
        steps = build(case)
        pipe.send(list(steps))
        for step, views, size, seed in iter(pipe.recv, None):
            images = smooth_image(seed, [1, views, 3, *size])
            style = case.network.style(seed, size)
            Path("/proc/self/clear_refs").write_text("5")  # the peak begins at what is held now
            started = time.process_time()
            result = steps[step](images, style)
            seconds = time.process_time() - started
            peak = re.findall(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
            pipe.send(
                (seconds, 1024.0 * int(peak[0]), result and {name: tensor.numpy() for name, tensor in result.items()})
            )
            del result


def differences(mine: Mapping[str, Any], theirs: Mapping[str, Any]) -> dict[str, Any]:
    """Of Gaussians with the same centres: the largest absolute difference, and that over the largest value."""
    distance, row = cKDTree(mine["means"]).query(theirs["means"])
    same = distance < SAME
    found: dict[str, Any] = {"Gaussians": [len(mine["means"]), len(same)], "same centres": float(same.mean())}
    for name, values in theirs.items():
        if name not in mine:
            continue
        worst = float(abs(mine[name][row[same]] - values[same]).max())
        found[name] = [worst, worst / float(abs(values[same]).max())]
    return found


def measure(case: Case, views: int, size: tuple[int, int], rounds: int) -> dict[str, Any]:
    """All scores, from rounds in which both take turns, each round with another scene and another style."""
    context, pipes, steps = multiprocessing.get_context("spawn"), {}, {}
    for build in (published, ours):  # the first writes the file
        name = build.__name__
        pipes[name], end = context.Pipe()
        context.Process(target=work, args=(build, case, end), daemon=True).start()
        end.close()
        steps[name] = pipes[name].recv()

    def take_turns(size: tuple[int, int], seed: int) -> dict[str, Any]:
        taken = {}
        for name, pipe in pipes.items():
            for step in steps[name]:
                pipe.send((step, views, size, seed))
                taken[name, step] = pipe.recv()
        return taken

    take_turns(case.network.warm_up, 0)  # both have seen all their weights
    turns = [take_turns(size, seed) for seed in range(1, rounds + 1)]
    for pipe in pipes.values():
        pipe.send(None)
    last = turns[-1]
    seconds = {" ".join(key): [turn[key][0] for turn in turns] for key in last}
    memory = {name: max(turn[key][1] for turn in turns for key in last if key[0] == name) for name in pipes}

    def ratio(first: str, second: str) -> float:
        pairs = zip(seconds[first], seconds[second], strict=True)
        return statistics.median(one / other for one, other in pairs)

    return {
        "setting": {
            "variant": case.variant, "views": views, "size": size, "rounds": rounds, "threads": case.threads,
            "torch": torch.__version__,
        },
        "CPU seconds": seconds,
        "peak bytes": memory,
        "one more style, times cheaper": ratio("published single", "ours style"),
        "single pass, share": ratio("ours single", "published single"),
        "memory, share": memory["ours"] / memory["published"],
        "products alone, share": statistics.median(
            float(turn["ours", "floor"][2]["seconds"]) / turn["ours", "single"][0] for turn in turns
        ),
        "differences": differences(last["ours", "style"][2], last["published", "single"][2]),
    }  # fmt: skip


def table(found: Mapping[str, Any]) -> str:
    """The scores in Markdown."""
    seconds = {key: statistics.median(values) for key, values in found["CPU seconds"].items()}
    memory = {key: value / 2**30 for key, value in found["peak bytes"].items()}
    whole, differs = seconds["published single"], dict(found["differences"])
    (mine, theirs), same = differs.pop("Gaussians"), differs.pop("same centres")
    lines = [
        f"| {found['setting']['variant']} | encode | one more style | single pass | peak memory |",
        "|---|---|---|---|---|",
        f"| published code | | {whole:.1f} s | {whole:.1f} s | {memory['published']:.1f} GiB |",
        f"| ours | {seconds['ours encode']:.1f} s | {seconds['ours style']:.1f} s | {seconds['ours single']:.1f} s "
        f"| {memory['ours']:.1f} GiB |",
        f"| | | {found['one more style, times cheaper']:.1f} times cheaper | {found['single pass, share']:.2f} of it "
        f"| {found['memory, share']:.2f} of it |",
        "", "| equality | largest difference | of the largest value |", "|---|---|---|",
        *(f"| {name} | {worst:.1e} | {share:.1e} |" for name, (worst, share) in differs.items()),
        f"\nAt the speed of a large product of matrices, the products and convolutions alone would take "
        f"{found['products alone, share']:.2f} of our single pass.",
        f"\n{mine} Gaussians of ours and {theirs} published, {same:.4%} of which have the same centres.",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"


def main() -> None:
    """Read the flags, measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("variant", choices=NETWORKS)
    parser.add_argument("checkout", type=Path)
    parser.add_argument("--views", type=int, default=2)
    parser.add_argument("--size", type=int, nargs=2, metavar=("HEIGHT", "WIDTH"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("published.json"))
    arguments = parser.parse_args()
    network = NETWORKS[arguments.variant]
    if not (arguments.checkout / network.file).is_file():
        raise UserError(f"{arguments.checkout} is no checkout of {network.repository}: it has no {network.file}")
    if find_spec("einops") is None:
        raise UserError("the published networks need einops: pip install einops")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "published.ckpt"
        case = Case(arguments.checkout.resolve(), arguments.variant, file, arguments.threads)
        found = measure(case, arguments.views, tuple(arguments.size or network.size), arguments.rounds)
    arguments.out.write_text(json.dumps(found, indent=1) + "\n")
    sys.stdout.write(table(found))


if __name__ == "__main__":
    run(main)
