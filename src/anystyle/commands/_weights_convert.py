"""Keep a checkpoint's tensors alone, in a safetensors file that says where they come from."""

import argparse
import json
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from anystyle.commands._flags import parse


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle weights convert``."""
    words = argparse.ArgumentParser(
        prog="anystyle weights convert",
        description="Write a checkpoint's tensors alone into a safetensors file: what training left behind is dropped "
        "and names lose their file's prefixes. The header says what was read. The result loads wherever the "
        "checkpoint does, faster and without a second copy in memory.",
        allow_abbrev=False,
    )
    words.add_argument("file", metavar="FILE", help="a file, or a row of `anystyle weights`")
    words.add_argument("out", metavar="OUT.safetensors", type=Path, help="where the result goes")
    return words


def main(words: Sequence[str]) -> int:
    """Run ``anystyle weights convert``.

    Returns:
        The exit status.

    Raises:
        ValueError: The file is not whole or of no known kind, or the result's name does not end in ``.safetensors``.
    """
    arguments = parse(parser(), words)
    out: Path = arguments.out
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
    return 0
