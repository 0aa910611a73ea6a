"""What the units of work of an evaluation cost in either way, and what they come to for the whole protocol.

``PYTHONPATH=tests python tests/benchmarks/evaluation_units.py [--size 448] [--rounds 3]`` measures, in turns, what one
image or pair takes as the published scripts do it and as this package does, with the same weights (filled by the
goldens' rule) and one thread unless ``OMP_NUM_THREADS`` says otherwise. Units are then counted for one scene of 50
styles x 16 frames. Reading and decoding, which both ways do, are left out."""

import argparse
import os
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from anystyle.metrics.cfsd import structural_distance
from anystyle.metrics.warp_consistency import corrected_warp, reference_warp
from anystyle.vision import art_score, embeddings, lpips, raft
from anystyle.vision.networks import load as load_features
from anystyle.vision.statistics import rgb_uv_histogram
from judging_cases import filled_folder
from oracle import smooth_image

STYLES, FRAMES = 50, 16

PAIRS = (FRAMES - 1 + FRAMES - 7) / FRAMES
"""Of neighbours and of distant frames, for each frame."""

Work = Callable[[], object]


def as_published(network: Any) -> Any:
    """A network with its weights laid out in memory as PyTorch's defaults are; changed in place."""
    return network.to(memory_format=torch.contiguous_format)


def published_flow(network: raft.Raft, first: Tensor, second: Tensor, iterations: int = 32) -> Tensor:
    """RAFT as published: every iteration reads the context anew, and upsamples its flow."""
    one, other = network.describe(first), network.describe(second)
    state, context = network.cnet(2 * first - 1).split(128, dim=1)
    state, context = state.tanh(), context.relu()
    pyramid = raft.correlation_pyramid(one, other)
    height, width = one.shape[-2:]
    y, x = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    start = torch.stack([x, y])[None].float()
    place, update = start, network.update_block
    fine = start
    for _ in range(iterations):
        motion = update.encoder(raft.look_up(pyramid, place), place - start)
        for half in (1, 2):
            conv = [getattr(update.gru, f"conv{gate}{half}") for gate in "zrq"]
            known = torch.cat([state, context, motion], dim=1)
            keep, reset = conv[0](known).sigmoid(), conv[1](known).sigmoid()
            proposed = conv[2](torch.cat([reset * state, context, motion], dim=1)).tanh()
            state = (1 - keep) * state + keep * proposed
        place = place + update.flow_head(state)
        fine = published_upsampling(place - start, 0.25 * update.mask(state))
    return fine


def published_upsampling(flow: Tensor, logits: Tensor) -> Tensor:
    """RAFT's, with all nine neighbours of each new pixel side by side."""
    count, _, height, width = flow.shape
    share = logits.reshape(count, 1, 9, 8, 8, height, width).softmax(dim=2)
    around = F.unfold(8 * flow, 3, padding=1).reshape(count, 2, 9, 1, 1, height, width)
    fine = (share * around).sum(2)  # M 2 8 8 h w
    return fine.permute(0, 1, 4, 2, 5, 3).reshape(count, 2, 8 * height, 8 * width)


CHANGES: tuple[Callable[[Any], Any], ...] = (lambda network: network, as_published)
"""What is done to a network that is loaded: nothing, and what makes it the published one."""


def units(size: int) -> dict[str, tuple[Work | None, Work | None, tuple[float, float, float]]]:
    """By name: as published, as here, and how often a stylized frame needs it: published, reference, corrected."""
    one, other = smooth_image(1, [1, 3, size, size]), smooth_image(2, [1, 3, size, size])
    large, small = smooth_image(3, [1, 3, 512, 512]), smooth_image(3, [1, 3, 299, 299])
    flow = 4 * smooth_image(4, [1, 2, size, size])
    seen = torch.ones(1, size, size, dtype=torch.bool)
    inception, plain_inception = (change(embeddings.load_art_inception("published")) for change in CHANGES)
    alex, plain_alex = (change(lpips.load("alex", "published")) for change in CHANGES)
    art, plain_art = (change(art_score.load()) for change in CHANGES)
    vgg16, plain_vgg16 = (change(lpips.load("vgg", "published")) for change in CHANGES)
    vgg19, plain_vgg19 = (change(load_features("vgg19")) for change in CHANGES)
    network, plain_network = (change(raft.load()) for change in CHANGES)
    described, context = network.describe(one), network.context(one)

    def similar() -> Tensor:
        # Filled weights make similarities flat; eight times as large they are not.
        maps = [8 * plain_vgg19(image, ("relu3_1",))[0][0].flatten(1).T for image in (one, other)]
        first, second = ((places / places.shape[1]) @ (places / places.shape[1]).T for places in maps)
        return F.kl_div(first.log_softmax(-1)[None], second.softmax(-1)[None], reduction="batchmean")

    shared, once = 1 / STYLES, 1 / FRAMES
    features = [8 * vgg19(image, ("relu3_1",))[0][0] for image in (one, other)]
    return {
        "inception at 512": (lambda: plain_inception(large), lambda: inception(large), (2, 1 + once, 0)),
        "inception at 299": (None, lambda: inception(small), (0, 0, 1 + once)),
        "alexnet at 512": (
            lambda: plain_alex.describe(large), lambda: alex.describe(large), (4, 2 + 2 * shared, 2 + 2 * shared)
        ),
        "art_score at 224": (lambda: plain_art(small[..., :224, :224]), lambda: art(small[..., :224, :224]), (1, 1, 1)),
        "histogram": (lambda: rgb_uv_histogram(one), lambda: rgb_uv_histogram(one), (2, 1 + once, 1 + once)),
        "cfsd, as published": (similar, None, (1, 0, 0)),
        "cfsd, features": (None, lambda: vgg19(one, ("relu3_1",)), (0, 1 + shared, 1 + shared)),
        "cfsd, similarities": (None, lambda: structural_distance(*features), (0, 1, 1)),
        "raft, as published": (lambda: published_flow(plain_network, one, other), None, (PAIRS, 0, 0)),
        "raft, frame": (None, lambda: (network.describe(one), network.context(one)), (0, 1, shared)),
        "raft, pair": (None, lambda: network.flow(described, described, context), (0, PAIRS, 2 * PAIRS * shared)),
        "lpips of warped frames": (lambda: plain_vgg16(one, other), lambda: vgg16(one, other), (PAIRS, PAIRS, PAIRS)),
        "warp": (
            lambda: reference_warp(one, other, flow), lambda: reference_warp(one, other, flow), (PAIRS, PAIRS, 0)
        ),
        "warp, corrected": (None, lambda: corrected_warp(one, other, flow, seen), (0, 0, PAIRS)),
    }  # fmt: skip


@torch.no_grad()
def compare(size: int, rounds: int) -> None:
    """Measure in turns and print."""
    work = units(size)
    spent: dict[tuple[str, int], list[float]] = {}
    for _ in range(rounds):
        for name, (*ways, _) in work.items():
            for way, do in enumerate(ways):
                if do is not None:
                    start = time.process_time()
                    do()
                    spent.setdefault((name, way), []).append(time.process_time() - start)
    sums = np.zeros(3)
    sys.stdout.write(f"seconds a stylized frame at {size} pixels: published, reference, corrected\n")
    for name, (*_, counts) in work.items():
        published, ours = (float(np.median(spent.get((name, way), [0.0]))) for way in (0, 1))
        found = np.array([published, ours, ours]) * counts
        sums += found
        sys.stdout.write(f"{name:<24}" + "".join(f"{value:8.3f}" for value in found) + "\n")
    sys.stdout.write(f"{'all':<24}" + "".join(f"{value:8.3f}" for value in sums) + "\n")
    sys.stdout.write(f"times the throughput: reference {sums[0] / sums[1]:.2f}, corrected {sums[0] / sums[2]:.2f}\n")


def main() -> None:
    """Read the flags and measure."""
    flags = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    flags.add_argument("--size", type=int, default=448)
    flags.add_argument("--rounds", type=int, default=3)
    words = flags.parse_args()
    os.environ["ANYSTYLE_WEIGHTS"] = str(filled_folder())
    compare(words.size, words.rounds)


if __name__ == "__main__":
    main()
