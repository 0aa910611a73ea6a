"""Checkpoints of the published size and layout, hash-filled, and what loading them takes.

No published weights are needed to measure: what a network costs does not depend on its values.

``python -m tests.support.full_size make anystyle_head FOLDER`` writes ``anystyle_head.safetensors`` in the published
types (the frozen transformers in bf16) and with ``--ckpt`` a training checkpoint beside it; ``longclip_b32`` and
``vggt`` are made the same way.

``python -m tests.support.full_size load FILE [OVERRIDE ...]`` loads a file in a process of its own, looks at every
tensor, and prints the peak of the process's own memory above where it began, in the size of the loaded model: without
the pages of the file, which the system takes back when it needs them.
"""

import argparse
import json
import pickle
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file
from torch import Tensor

from anystyle.pipeline.load import build_and_load
from anystyle.registry.compose import compose
from anystyle.testing.oracle import fill_named
from anystyle.vision.clip import Clip
from tests.support.oracle import golden

KINDS = ("anysplat", "anystyle_head", "anystyle_full", "vggt", "longclip_b32")
NAMES = {torch.float32: "F32", torch.bfloat16: "BF16"}
FILES = {"longclip_b32": "longclip-B-32"}

LOAD = """
import json, sys
import torch
from anystyle.pipeline.load import build_and_load
from tests.support.resident import sampled_peak
from anystyle.pipeline.weights import load_reference
from anystyle.registry.compose import compose

# The program itself, which is no matter of weights.
with torch.device("meta"):
    build_and_load(compose("stylize", ["~model", "backbone=anysplat", "style_encoder=long_clip"]), {}, {})
result = {}

def load():
    stylizer = load_reference(sys.argv[1], overrides=sys.argv[2:])
    tensors = list(stylizer.state_dict().values())
    # Every tensor is looked at, as a first forward pass would.
    result["total"] = sum(float(tensor.sum()) for tensor in tensors)
    result["size"] = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    result["tensors"] = len(tensors)
    result["types"] = sorted({str(tensor.dtype) for tensor in tensors})

result["peak"] = -sampled_peak(lambda: None) + sampled_peak(load)
print(json.dumps(result))
"""


def shapes(kind: str) -> dict[str, Tensor]:
    """The tensors of a published file, without memory, under its names and in its types."""
    if kind == "longclip_b32":
        with torch.device("meta"):
            extra = {"logit_scale": torch.empty(()), "positional_embedding_res": torch.empty(248, 512)}
            return dict(Clip(context=248).state_dict()) | extra
    model = "anysplat" if kind == "vggt" else kind
    config = compose("stylize", [f"model={model}", "style_encoder=long_clip"])
    with torch.device("meta"):
        stylizer, _ = build_and_load(config, {}, {})
    from anystyle_backbones.anysplat import keys

    state = stylizer.backbone.state_dict()
    found = {name: state[key] for key, name in keys.backbone_names(state).items()}
    found["aggregator.patch_embed.mask_token"] = torch.empty(1, 1024, device="meta")
    if kind == "vggt":
        found = {name: tensor for name, tensor in found.items() if not name.startswith("gaussian_param_head.")}
        return found | {f"{part}_head.it": torch.empty(1024, 1024, device="meta") for part in ("point", "track")}
    if kind == "anysplat":
        return {f"encoder.{name}": tensor for name, tensor in found.items()}
    branch = stylizer.branch.state_dict()
    found |= {name: branch[key] for key, name in keys.branch_names(branch).items()}
    for layer in (0, 2):
        found[f"text_adapter.mlp.{layer}.weight"] = torch.empty(512, 512, device="meta")
        found[f"text_adapter.mlp.{layer}.bias"] = torch.empty(512, device="meta")
    return {
        f"model.encoder.{name}": tensor.bfloat16() if name.startswith("aggregator.") else tensor
        for name, tensor in found.items()
    }


def make(kind: str, folder: Path, ckpt: bool) -> None:
    """Write a checkpoint tensor by tensor, and on request a training checkpoint of the same tensors."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{FILES.get(kind, kind)}.safetensors"
    tensors, header, place = shapes(kind), {}, 0
    for key, tensor in tensors.items():
        end = place + tensor.numel() * tensor.element_size()
        header[key] = {"dtype": NAMES[tensor.dtype], "shape": list(tensor.shape), "data_offsets": [place, end]}
        place = end
    encoded = json.dumps(header, separators=(",", ":")).encode()
    encoded = encoded.ljust(-(-len(encoded) // 8) * 8)
    rules = golden("golden_e2e")["fill"]["rules"]
    with path.open("wb") as file:
        file.write(len(encoded).to_bytes(8, "little") + encoded)
        for key, like in tensors.items():
            bare = key.removeprefix("model.").removeprefix("encoder.")
            tensor = fill_named({bare: like}, rules)[bare].to(like.dtype)
            file.write(tensor.reshape(-1).view(torch.uint8).numpy().tobytes())
    if ckpt or kind in FILES:
        state = load_file(path)
        other = path.with_suffix(".pt" if kind in FILES else ".ckpt")
        torch.save(state if kind in FILES else {"state_dict": state, "global_step": 0}, other, pickle_module=pickle)


def load(file: Path, overrides: Sequence[str]) -> dict[str, Any]:
    """What loading a file takes, in a process of its own."""
    command = [sys.executable, "-c", LOAD, str(file), *overrides]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[2])
    if done.returncode:
        raise ValueError(done.stderr.strip().splitlines()[-1])
    return json.loads(done.stdout)


def main(words: Sequence[str] | None = None) -> None:
    """Run the program."""
    flags = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = flags.add_subparsers(dest="command", required=True)
    making = commands.add_parser("make")
    making.add_argument("kind", choices=KINDS)
    making.add_argument("folder", type=Path)
    making.add_argument("--ckpt", action="store_true")
    loading = commands.add_parser("load")
    loading.add_argument("file", type=Path)
    loading.add_argument("override", nargs="*")
    arguments = flags.parse_args(words)
    if arguments.command == "make":
        make(arguments.kind, arguments.folder, arguments.ckpt)
        return
    result = load(arguments.file, arguments.override)
    size = result["size"]
    types = ", ".join(result["types"])
    sys.stdout.write(f"{size / 2**30:.2f} GiB of weights ({result['tensors']} tensors, {types})\n")
    sys.stdout.write(f"peak {result['peak'] / size:.3f}\n")


if __name__ == "__main__":
    main()
