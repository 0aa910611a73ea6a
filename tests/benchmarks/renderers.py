"""Seconds of every renderer that runs here, for one view of random Gaussians, forward and with gradients.

``python -m tests.benchmarks.renderers [GAUSSIANS] [SCALE]``, in the project's folder: of the process on the CPU, by the
clock on a graphics card, medians of five after one. ``renderer=cpu`` on a card includes its copies there and back.
"""

import sys
import time
from collections.abc import Callable
from dataclasses import replace

import torch

from anystyle.registry.catalog import catalog
from tests.support.scenes import cameras, gaussians

DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")


def median(work: Callable[[], object]) -> float:
    seconds = []
    for _ in range(6):
        clock = time.process_time if DEVICE.type == "cpu" else time.perf_counter
        start = clock()
        work()
        if DEVICE.type == "cuda":
            torch.cuda.synchronize()
        seconds.append(clock() - start)
    return sorted(seconds[1:])[2]


def main(number: int = 50_000, scale: float = 0.1) -> None:
    scene, view = gaussians(1, number), cameras(1, 1, (224, 448)).to(DEVICE)
    scene = replace(scene, scales=scale * scene.scales).to(DEVICE)
    reference = None
    for name in ("torch", "gsplat", "warp", "cpu"):
        cls = catalog().find("renderer", name).load()
        if cls.lacks() or (DEVICE.type == "cpu" and "cuda" in cls.devices[:1]):
            continue
        renderer, place = cls(), "cpu" if cls.devices == ("cpu",) else DEVICE

        def work(gradients: bool, renderer=renderer, place=place) -> torch.Tensor:
            leaves = scene.map(lambda tensor: tensor.clone().requires_grad_(gradients))
            color = renderer(leaves.to(place), view.to(place)).color.to(DEVICE)
            if gradients:
                color.square().sum().backward()
            return color.detach()

        reference = work(False) if reference is None else reference
        apart = float((work(False) - reference).abs().max())
        forward, both = (median(lambda gradients=gradients: work(gradients)) for gradients in (False, True))
        line = f"{name:8} {DEVICE.type} forward {forward:.4f} with gradients {both:.4f} apart {apart:.1e}"
        print(line, flush=True)  # noqa: T201


if __name__ == "__main__":
    main(*(kind(word) for kind, word in zip((int, float), sys.argv[1:], strict=False)))
