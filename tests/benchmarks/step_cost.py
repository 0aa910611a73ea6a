"""What a step of the Head variant costs at full width, side by side with one that does not know what is frozen.

``PYTHONPATH=tests python tests/benchmarks/step_cost.py --depth 12`` measures in turn, each in a process of its own, at
the published width:

- ``ours``: the training's own step: the backbone under ``no_grad``, the branch differentiated;
- ``straightforward``: the same step with the backbone run and differentiated as if it learned too, and all terms
  differentiated at the end.

It prints seconds and peak memory of both. The peak is that of the steps: weights, gradients, the optimiser's averages,
activations and the interpreter. ``--objective paper`` takes the five published terms with VGG-19 and CLIP ViT-B/32,
whose weights do not matter for the cost.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import torch

from anystyle.losses import clip_patch, features
from anystyle.registry.compose import compose
from anystyle.training.run import make_data, make_training
from anystyle.vision import weights
from style_cases import filled_vgg_file

KINDS = ("ours", "straightforward")
OBJECTIVES = {
    "light": ("loss=[total_variation,luminance]",),
    "paper": (
        "loss=[content,style,clip_directional,clip_patch,depth_consistency]", "style_encoder=long_clip",
        "training.text_ratio=0",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Case:
    """What is measured.

    Args:
        depth: Blocks of the embedder and pairs of blocks of the aggregator; published: 24.
        side: Of the square views in pixels, a multiple of 14.
        views: Of the one scene of a step.
        objective: ``light`` or ``paper``.
        steps: Measured after a first one, which allocates; the least counts.
    """

    depth: int = 12
    side: int = 112
    views: int = 2
    objective: str = "paper"
    steps: int = 2

    def words(self) -> list[str]:
        """The overrides of ``anystyle train``."""
        taps = (4, 11, 17, 23) if self.depth == 24 else [(place + 1) * self.depth // 4 - 1 for place in range(4)]
        return [
            "backbone=anysplat", f"backbone.depth={self.depth}", f"backbone.embed_depth={self.depth}",
            f"backbone.taps=[{','.join(map(str, taps))}]", f"backbone.camera_depth={max(1, self.depth // 6)}",
            f"backbone.native_resolution={self.side}", f"backbone.resolution={self.side}", "backbone.init=scratch",
            "renderer=cpu", "training=stylization", "training.batch_size=1",
            f"training.context_views=[{self.views},{self.views}]", "training.spread=any", "training.heights=null",
            "training.width=null", "scenes=procedural", f"scenes.size={self.side}", "scenes.num_scenes=2",
            "scenes.samples=1", "styles=procedural", "styles.size=224", *OBJECTIVES[self.objective],
            "name=cost", "out=.",
        ]  # fmt: skip


def measure(case: Case, kind: str) -> dict[str, float]:
    """Seconds a step, the least of a few, and the peak memory of the steps in bytes."""
    torch.set_num_threads(1)
    os.environ[weights.FOLDERS] = str(filled_vgg_file().parent)
    config = compose("train", case.words())
    training = make_training(config)
    source = make_data(config, training).train
    stylizer = training.stylizer
    if kind == "straightforward":
        stylizer.backbone.requires_grad_(True)
        training.encoded.encode = stylizer.backbone.encode
        for module in (clip_patch, features):
            module.eager_backward = lambda function, images: function(images)
    learns = [parameter for parameter in training.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(stylizer.branch.parameters(), lr=1e-4)
    training.train()
    batches = [source.batch(step) for step in range(1 + case.steps)]
    seconds, busy = [], []
    forget_peak()
    for step, batch in enumerate(batches):
        start, started = time.perf_counter(), time.process_time()
        result = training.stylize(batch, training.embed(batch.style, step))
        terms = training.losses
        if kind == "straightforward":
            sum(term.weight * term(result) for term in terms.values()).backward()
        else:
            features.objective(terms, result)[0].backward()
        optimizer.step()
        for parameter in learns:
            parameter.grad = None
        del result
        seconds.append(time.perf_counter() - start)
        busy.append(time.process_time() - started)
    return {"seconds": min(seconds[1:]), "processor seconds": min(busy[1:]), "bytes": peak()}


def forget_peak() -> None:
    """Let the process's peak begin at what it holds now."""
    Path("/proc/self/clear_refs").write_text("5")


def peak() -> float:
    """The most memory that the process has held since, in bytes."""
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    assert found is not None
    return 1024.0 * int(found[1])


def compare(case: Case, rounds: int = 1) -> dict[str, float]:
    """Both steps in processes of their own, in turn, and the ratios of the least of each."""
    found: dict[str, dict[str, float]] = {}
    for _ in range(rounds):
        for kind in KINDS:
            command = [sys.executable, __file__, "--only", kind, "--case", json.dumps(asdict(case))]
            done = subprocess.run(
                command, capture_output=True, text=True, env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
            )
            if done.returncode:
                raise RuntimeError(done.stderr)
            measured = json.loads(done.stdout.splitlines()[-1])
            found[kind] = {name: min(value, found.get(kind, measured)[name]) for name, value in measured.items()}
    ours, plain = (found[kind] for kind in KINDS)
    return {
        "seconds": ours["seconds"],
        "seconds of the straightforward": plain["seconds"],
        "time ratio": ours["seconds"] / plain["seconds"],
        "processor time ratio": ours["processor seconds"] / plain["processor seconds"],
        "gigabytes": ours["bytes"] / 1e9,
        "gigabytes of the straightforward": plain["bytes"] / 1e9,
        "memory ratio": ours["bytes"] / plain["bytes"],
    }


def main(words: Sequence[str]) -> None:
    """Read the case, measure it, and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, value in asdict(Case()).items():
        parser.add_argument(f"--{name}", type=type(value), default=value)
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--only", choices=KINDS)
    parser.add_argument("--case", type=json.loads)
    arguments = parser.parse_args(words)
    case = Case(**(arguments.case or {name: getattr(arguments, name) for name in asdict(Case())}))
    if arguments.only:
        sys.stdout.write(json.dumps(measure(case, arguments.only)) + "\n")
    else:
        for name, value in compare(case, arguments.rounds).items():
            sys.stdout.write(f"{name:<34} {value:.4g}\n")


if __name__ == "__main__":
    main(sys.argv[1:])
