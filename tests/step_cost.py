"""What a step of the Head variant costs at full width, side by side with one that does not know what is frozen.

``python tests/step_cost.py`` measures, each in a process of its own, at the published width and a reduced depth:

- ``ours``: the training's own step: the backbone under ``no_grad``, the branch differentiated;
- ``straightforward``: the same step with the backbone run and differentiated as if it learned too.

It prints seconds and peak memory of both, the share of the injectors, and how fast the data pipeline feeds.
"""

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from PIL import Image

from anystyle.data.scene_folder import FolderScenes
from anystyle.registry.compose import compose
from anystyle.training.data import SceneBatches
from anystyle.training.run import make_data, make_training
from anystyle.types import StyleEmbedding, Tokens

SIDE, VIEWS, STEPS = 112, 2, 2
WORDS = (
    "backbone=anysplat", "backbone.depth=4", "backbone.taps=[0,1,2,3]", "backbone.embed_depth=4",
    "backbone.camera_depth=1", "backbone.native_resolution=112", f"backbone.resolution={SIDE}", "backbone.init=scratch",
    "renderer=cpu", "training=stylization", "training.batch_size=1", f"training.context_views=[{VIEWS},{VIEWS}]",
    "training.spread=any", "training.heights=null", "training.width=null", f"scenes.size={SIDE}", "scenes.num_scenes=2",
    "scenes.samples=1", "styles=procedural", "styles.size=64", "loss=[total_variation,luminance]", "name=cost", "out=.",
)  # fmt: skip


def measure(kind: str) -> dict[str, float]:
    """Seconds a step, the least of a few, and the process's peak memory in bytes."""
    torch.set_num_threads(1)
    config = compose("train", list(WORDS))
    training = make_training(config)
    source = make_data(config, training).train
    stylizer = training.stylizer
    if kind == "straightforward":
        stylizer.backbone.requires_grad_(True)
        training.encoded.encode = stylizer.backbone.encode
    learns = [parameter for parameter in training.parameters() if parameter.requires_grad]
    optimizer = torch.optim.AdamW(stylizer.branch.parameters(), lr=1e-4)
    training.train()
    batches = [source.batch(step) for step in range(1 + STEPS)]
    seconds = []
    for step, batch in enumerate(batches):
        start = time.perf_counter()
        result = training.stylize(batch, training.embed(batch.style, step))
        sum(term.weight * term(result) for term in training.terms.values()).backward()
        optimizer.step()
        for parameter in learns:
            parameter.grad = None
        seconds.append(time.perf_counter() - start)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    measured = {"seconds": min(seconds[1:]), "bytes": float(peak)}
    if kind == "ours":
        measured["injectors"] = injectors(stylizer, training.embed(batches[0].style, 0))
    return measured


def injectors(stylizer, embedding: StyleEmbedding) -> float:
    """Seconds that all injectors take forth and back in a step, beyond handing the tokens on."""
    grid = (SIDE // 14, SIDE // 14)
    total = 0.0
    for site in stylizer.backbone.gaussian_head.sites:
        pixels = site.name == "head/direct"
        shape = (SIDE, SIDE) if pixels else grid
        tokens = Tokens(torch.randn(1, VIEWS, shape[0] * shape[1], site.dim, requires_grad=True), grid=shape)
        grad = torch.randn_like(tokens.data)
        injector = stylizer.branch.injectors[site.name]
        times = []
        for _ in range(5):
            start = time.perf_counter()
            injector(tokens, embedding.vector).data.backward(grad)
            times.append(time.perf_counter() - start)
            tokens.data.grad = None
            injector.zero_grad()
        total += min(times)
    return total


def pipeline() -> float:
    """Images a second that one process reads, decodes and fits to the published sizes from photographs as DL3DV's."""
    with tempfile.TemporaryDirectory() as folder:
        noise = np.random.default_rng(0)
        for number in range(40):
            small = Image.fromarray(noise.integers(0, 255, (34, 60, 3), dtype=np.uint8))
            path = Path(folder) / "scene" / "images_8" / f"{number:04d}.jpg"
            path.parent.mkdir(parents=True, exist_ok=True)
            small.resize((480, 270)).save(path, quality=92)
        scenes = FolderScenes(root=folder, images="images_8", short_side=270, multiple=1)
        source = SceneBatches(scenes, batch_size=1, context_views=(4, 4), heights=(224, 448), width=448)
        source.batch(0)
        start = time.perf_counter()
        images = sum(source.batch(step).num_images for step in range(1, 9))
        return images / (time.perf_counter() - start)


def compare() -> dict[str, float]:
    """Both steps in processes of their own, and the ratios."""
    found = {}
    for kind in ("ours", "straightforward"):
        command = [sys.executable, __file__, kind]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        found[kind] = json.loads(done.stdout.splitlines()[-1])
    ours, plain = found["ours"], found["straightforward"]
    return {
        "seconds": ours["seconds"],
        "seconds of the straightforward": plain["seconds"],
        "time ratio": ours["seconds"] / plain["seconds"],
        "gigabytes": ours["bytes"] / 1e9,
        "gigabytes of the straightforward": plain["bytes"] / 1e9,
        "memory ratio": ours["bytes"] / plain["bytes"],
        "injectors' share": ours["injectors"] / ours["seconds"],
        "pipeline ratio": pipeline() / (VIEWS / ours["seconds"]),
    }


if __name__ == "__main__":
    if sys.argv[1:]:
        sys.stdout.write(json.dumps(measure(sys.argv[1])) + "\n")
    else:
        for name, value in compare().items():
            sys.stdout.write(f"{name:<34} {value:.4g}\n")
