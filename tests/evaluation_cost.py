"""What judging a scene costs, side by side with scoring pair by pair as the published scripts do.

``python tests/evaluation_cost.py [--size 448] [--styles 2] [--frames 16] [--rounds 1]`` writes images of one scene in a
few styles and judges them, in turns, in three ways, with the same networks (filled by the goldens' rule) and as many
threads (``OMP_NUM_THREADS``):

- ``reference``: ``anystyle evaluate``'s own way, all metrics of ``variant=reference`` in one pass;
- ``corrected``: the same of ``variant=corrected``, with ``kid`` beside them;
- ``pairs``: the published scripts' way, each metric by itself, pair after pair: both images are read, decoded and
  looked at for every pair, a style image as often as it has results, and RAFT's context and upsampling are computed in
  every iteration.

``reference`` and ``pairs`` have to give the same figures; those of ``corrected`` are others, as meant. It prints
seconds by metric, the ratios to ``pairs``, and the ratios for 50 styles: what depends on the number of styles is
measured by its slope. Seconds are those of the processor: what else the machine does does not count.
"""

import argparse
import os
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
import torch.nn.functional as F
from PIL import Image
from torch import Tensor

from anystyle.commands.evaluate import make_metrics
from anystyle.contracts import Metric
from anystyle.evaluation.folders import Cell, pair, read
from anystyle.evaluation.resume import judge_pairing
from anystyle.geometry.warp import backward_warp, softmax_splat
from anystyle.metrics.art_fid import ArtFID
from anystyle.perception import preprocess, raft
from anystyle.perception.feature_cache import CACHE
from anystyle.perception.statistics import hellinger, rgb_uv_histogram
from anystyle.registry.compose import compose
from judging_cases import filled_folder
from oracle import smooth_image

STYLES, FRAMES = 50, 16

Network = TypeVar("Network", bound=torch.nn.Module)


def write_scene(root: Path, size: int, styles: int, frames: int) -> None:
    """Photographs that move a little, style images, and mixtures of both."""
    wide = smooth_image(21, [3, size, size + 2 * frames])
    fine = smooth_image(22, [3, size, size + 2 * frames])
    for frame in range(frames):
        here = slice(2 * frame, 2 * frame + size)
        _save(root / "content" / "scene" / f"{frame:03d}.jpg", 0.7 * wide[..., here] + 0.3 * fine[..., here])
        for style in range(styles):
            look = smooth_image(31 + style, [3, size, size + 2 * frames])[..., here]
            image = 0.5 * wide[..., here] + 0.2 * fine[..., here] + 0.3 * look
            _save(root / "stylized" / "scene" / f"{style:02d}_{frame:03d}.jpg", image)
    for style in range(styles):
        _save(root / "style" / f"{style:02d}.jpg", smooth_image(31 + style, [3, 256, 256]))


def _save(path: Path, image: Tensor) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((image.clamp(0, 1) * 255).byte().permute(1, 2, 0).numpy()).save(path, quality=75)


def make(variant: str) -> dict[str, Metric]:
    """All metrics of the published protocol."""
    metrics = make_metrics(compose("evaluate", [f"variant={variant}"]), None, torch.device("cpu"))
    # Similarities of a filled VGG-19 are nearly flat, and CFSD nothing but rounding; stronger ones are not.
    metrics["cfsd"].network.features[0].weight.data *= 8
    return metrics


def in_one_pass(root: Path, variant: str) -> tuple[dict[str, float], dict[str, float]]:
    """Figures, and the seconds of each metric; what is read and decoded is counted as ``reading``."""
    CACHE.clear()
    metrics = make(variant)
    seconds = dict.fromkeys(metrics, 0.0)
    for name, metric in metrics.items():
        metric.update = _timed(metric.update, seconds, name)
        metric.compute = _timed(metric.compute, seconds, name)
    start = time.process_time()
    cells = pair(root / "content", root / "style", root / "stylized")
    with tempfile.TemporaryDirectory() as out:
        found = judge_pairing(metrics, cells, Path(out), lambda *_: None)
    seconds["reading"] = time.process_time() - start - sum(seconds.values())
    return dict(found.figures), seconds


def _timed(work: Callable[..., object], seconds: dict[str, float], name: str) -> Callable[..., object]:
    def watched(*given: object) -> object:
        start = time.process_time()
        try:
            return work(*given)
        finally:
            seconds[name] += time.process_time() - start

    return watched


@torch.no_grad()
def pair_by_pair(root: Path) -> tuple[dict[str, float], dict[str, float]]:
    """The same, as scripts do that know one pair at a time."""
    metrics = make("reference")
    for metric in metrics.values():
        as_published(metric)
    # RAFT is no sub-module of the metric.
    as_published(metrics["warp_consistency"].correspondence.network)
    cells = pair(root / "content", root / "style", root / "stylized").cells
    ways = {
        "art_score": _art_score, "art_fid": _art_fid, "lpips_gray": _lpips_gray, "cfsd": _cfsd,
        "color_match": _color_match, "warp_consistency": _warp_consistency,
    }  # fmt: skip
    figures: dict[str, float] = {}
    seconds: dict[str, float] = {}
    for name, way in ways.items():
        start = time.process_time()
        figures.update(way(metrics[name], cells))
        seconds[name] = time.process_time() - start
    return figures, seconds


def as_published(network: Network) -> Network:
    """A network with its weights laid out in memory as PyTorch's defaults are; changed in place."""
    return network.to(memory_format=torch.contiguous_format)


def _triples(cells: tuple[Cell, ...]) -> list[tuple[Path, Path, Path]]:
    return [
        (stylized, content, cell.reference)
        for cell in cells
        for stylized, content in zip(cell.stylized, cell.content, strict=True)
    ]


def _at(path: Path, size: int) -> Tensor:
    return preprocess.resized(read(path)[None], size, rounded=True)


def _art_score(metric, cells) -> dict[str, float]:
    return {"art_score": _mean(metric.network(_at(stylized, 224)) for stylized, _, _ in _triples(cells))}


def _art_fid(metric: ArtFID, cells) -> dict[str, float]:
    triples = _triples(cells)
    for stylized, _, style in triples:
        metric.stylized.append(metric.inception(_at(stylized, 512)))
        metric.style.append(metric.inception(_at(style, 512)))
    distance = _mean(metric.network(_at(one, 512), _at(other, 512)) for one, other, _ in triples)
    # The published matrix roots are no matter of throughput: tests/metrics/test_frechet.py compares them.
    fid = float(metric.compute()["fid"])
    return {"fid": fid, "lpips": distance, "art_fid": (1 + distance) * (1 + fid)}


def _lpips_gray(metric, cells) -> dict[str, float]:
    def look(path: Path) -> Tensor:
        return preprocess.gray(_at(path, 512), rounded=True)

    return {"lpips_gray": _mean(metric.network(look(one), look(other)) for one, other, _ in _triples(cells))}


def _cfsd(metric, cells) -> dict[str, float]:
    def similarities(path: Path) -> Tensor:
        features = metric.network(read(path)[None], ("relu3_1",))[0][0].flatten(1).T
        features = features / features.shape[1]
        return features @ features.T

    def distance(one: Path, other: Path) -> Tensor:
        found, wanted = similarities(one).log_softmax(-1), similarities(other).softmax(-1)
        return F.kl_div(found[None], wanted[None], reduction="batchmean")

    return {"cfsd": _mean(distance(one, other) for one, other, _ in _triples(cells))}


def _color_match(metric, cells) -> dict[str, float]:
    return {
        "color_match": _mean(
            hellinger(rgb_uv_histogram(read(style)[None]), rgb_uv_histogram(read(one)[None]))
            for one, _, style in _triples(cells)
        )
    }


def _warp_consistency(metric, cells) -> dict[str, float]:
    found: dict[str, list[float]] = {}
    for cell in cells:
        for span, gap in (("short", 1), ("long", 7)):
            values = [
                _one_warp(metric, read(one)[None], read(other)[None])
                for one, other in zip(cell.stylized[:-gap], cell.stylized[gap:], strict=True)
            ]
            for kind, numbers in zip(("rmse", "lpips"), zip(*values, strict=True), strict=True):
                found.setdefault(f"warp_{kind}_{span}", []).append(float(np.mean(numbers)))
    return {name: float(np.mean(values)) for name, values in found.items()}


def _one_warp(metric, source: Tensor, target: Tensor) -> tuple[float, float]:
    flow = published_flow(metric.correspondence.network, source, target)
    source, target = 255 * source, 255 * target
    difference = (source - backward_warp(target, flow)).abs().mean(1, keepdim=True)
    warped = softmax_splat(source, flow, (-10 * difference).clamp(-10, 10)).image
    masked = target * (warped.sum(1, keepdim=True) != 0)
    distance = metric.network((warped + 1) / 2, (masked + 1) / 2)
    return float((warped - masked).square().mean().sqrt() / 255), float(distance)


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
        fine = published_upsampling(place - start, update.upsampling_logits(state))
    return fine


def published_upsampling(flow: Tensor, logits: Tensor) -> Tensor:
    """RAFT's, with all nine neighbours of each new pixel side by side."""
    count, _, height, width = flow.shape
    share = logits.reshape(count, 1, 9, 8, 8, height, width).softmax(dim=2)
    around = F.unfold(8 * flow, 3, padding=1).reshape(count, 2, 9, 1, 1, height, width)
    fine = (share * around).sum(2)  # M 2 8 8 h w
    return fine.permute(0, 1, 4, 2, 5, 3).reshape(count, 2, 8 * height, 8 * width)


def _mean(values) -> float:
    return float(np.mean([float(value) for value in values]))


def agree(ours: dict[str, float], pairs: dict[str, float]) -> None:
    """Refuse to compare the speed of two ways that say different things."""
    for name, value in pairs.items():
        np.testing.assert_allclose(ours[name], value, rtol=2e-3, err_msg=name)


def compare(size: int, styles: int, frames: int, rounds: int) -> None:
    """Measure in turns and print."""
    ways = {
        "reference": lambda root: in_one_pass(root, "reference"),
        "corrected": lambda root: in_one_pass(root, "corrected"),
        "pairs": pair_by_pair,
    }
    seconds: dict[tuple[str, int], list[dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        counts = sorted({max(1, styles // 2), styles})
        for count in counts:
            write_scene(Path(folder) / str(count), size, count, frames)
        for turn in range(rounds):
            for count in counts:
                found = {}
                for way, work in ways.items():
                    found[way], spent = work(Path(folder) / str(count))
                    seconds.setdefault((way, count), []).append(spent)
                    say(f"round {turn} {way:<9} {count} styles: {sum(spent.values()):8.1f} s")
                agree(found["reference"], found["pairs"])
    say(f"\n{styles} styles x {frames} frames at {size} pixels, {torch.get_num_threads()} thread(s)")
    tell(seconds, styles)


def tell(seconds: dict[tuple[str, int], list[dict[str, float]]], styles: int) -> None:
    """Print medians over the rounds: of each metric, of all, and what they come to with 50 styles."""
    names = list(dict.fromkeys(name for runs in seconds.values() for name in runs[0]))
    for name in [*names, "all"]:
        spent = {
            way: float(np.median([sum(run.values()) if name == "all" else run.get(name, 0.0) for run in runs]))
            for (way, count), runs in seconds.items()
            if count == styles
        }
        ratios = [f"{spent['pairs'] / max(spent[way], 1e-9):5.2f}" for way in ("reference", "corrected")]
        say(f"{name:<18}" + "".join(f"{way} {value:8.1f} s  " for way, value in spent.items()) + " ".join(ratios))
    totals = {key: float(np.median([sum(run.values()) for run in runs])) for key, runs in seconds.items()}
    counts = sorted({count for _, count in totals})
    if len(counts) < 2:
        return
    few, many = counts
    far = {
        way: totals[way, many] + (totals[way, many] - totals[way, few]) / (many - few) * (STYLES - many)
        for way in ("reference", "corrected", "pairs")
    }
    for way in ("reference", "corrected"):
        say(f"{way}, by its slope at {STYLES} styles: {far['pairs'] / far[way]:.2f} times the throughput of pairs")


def say(line: str) -> None:
    """Print at once: what comes next takes long."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main() -> None:
    """Read the flags and measure."""
    flags = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    flags.add_argument("--size", type=int, default=224)
    flags.add_argument("--styles", type=int, default=2)
    flags.add_argument("--frames", type=int, default=FRAMES)
    flags.add_argument("--rounds", type=int, default=1)
    words = flags.parse_args()
    os.environ["ANYSTYLE_WEIGHTS"] = str(filled_folder())
    compare(words.size, words.styles, words.frames, words.rounds)


if __name__ == "__main__":
    main()
