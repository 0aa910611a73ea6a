"""What ``anystyle weights`` does with one file: verify, convert, download."""

import argparse
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from anystyle.commands._flags import new_parser, parse

ROW = "a file, or a row of `anystyle weights`"


def verify(words: Sequence[str]) -> None:
    """Say what a file of weights holds, and whether it is whole."""
    arguments = _arguments(
        words,
        "verify",
        "Say what a file of weights holds, and whether it is whole: every tensor that its network needs, no other, of "
        "the right shape; and its checksum where one is published. Nothing in the file is executed.",
        file=ROW,
    )
    from anystyle.commands._weights_file import checksum, existing, recognise
    from anystyle.perception import bpe, weights

    path = existing(arguments.file)
    digest = checksum(path)
    if path.name == weights.row("clip_vocabulary").file:
        holds = [f"a vocabulary of {len(bpe.load(path, 49408).ids) + 2} tokens"]
    else:
        holds = list(recognise(path).holds)
    print("\n".join([f"{path} is whole", *(f"  {line}" for line in holds), f"  sha256 {digest}"]))


def convert(words: Sequence[str]) -> None:
    """Keep a checkpoint's tensors alone, in a safetensors file that says where they come from."""
    arguments = _arguments(
        words,
        "convert",
        "Write a checkpoint's tensors alone into a safetensors file: what training left behind is dropped and names "
        "lose their file's prefixes. The header says what was read. The result loads wherever the checkpoint does, "
        "faster and without a second copy in memory.",
        file=ROW,
        out="where the result goes; ends in .safetensors",
    )
    out = Path(arguments.out)
    if out.suffix != ".safetensors":
        raise ValueError(f"the result is called {out}; let its name end in .safetensors")
    from anystyle.commands._weights_file import existing, recognise
    from anystyle.io.checkpoint import save_tensors, sha256

    path = existing(arguments.file)
    if out.exists() and out.samefile(path):
        raise ValueError(f"{out} is the file that is read; give the result another name")
    known = recognise(path)
    if known.layout == "anystyle":
        raise ValueError(f"{path} is a file that anystyle wrote; there is nothing to convert")
    provenance = {"file": path.name, "sha256": sha256(path), "converted_by": f"anystyle {version('anystyle')}"}
    metadata = {
        "format": "pt",
        "layout": known.layout,
        "holds": "; ".join(known.holds),
        "provenance": json.dumps(provenance, sort_keys=True),
    }
    save_tensors(out, {key: tensor.contiguous() for key, tensor in known.state.items()}, metadata)
    print(f"{out}: {'; '.join(known.holds)}")


def download(words: Sequence[str]) -> None:
    """Fetch a file of weights from the Hugging Face hub."""
    name = _arguments(
        words,
        "download",
        "Fetch a file of weights from the Hugging Face hub into its cache, with a progress bar; an interrupted "
        "download goes on where it stopped.",
        name="a row of `anystyle weights`",
    ).name
    from anystyle.perception import weights

    try:
        path = weights.find(name)
    except FileNotFoundError:
        path = weights.download(name)
    if weights.verified(name, path) is False:
        raise ValueError(f"{path} is not the published {name}; get it again from {weights.row(name).source}")
    print(path)


def _arguments(words: Sequence[str], command: str, description: str, **positional: str) -> argparse.Namespace:
    parser = new_parser(f"weights {command}", description)
    for name, text in positional.items():
        parser.add_argument(name, metavar=name.upper(), help=text)
    return parse(parser, words)
