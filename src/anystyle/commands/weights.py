"""Which checkpoints there are, where each comes from and where it was looked for; verify, convert, download one."""

import argparse
import json
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.errors import UserError, unknown

ROW = "a file, or a row of `anystyle weights`"
COMMANDS = {
    "verify": (
        "Check that a file of weights is whole (every tensor of its network, of the right shape, no others, and the "
        "published checksum if there is one), and print what it holds. Nothing in the file is executed.",
        {"file": ROW},
    ),
    "convert": (
        "Write a checkpoint's tensors into a safetensors file, without a trainer's state and prefixes of names; its "
        "header names the source. It loads wherever the checkpoint does, faster and without a second copy in memory.",
        {"file": ROW, "out": "the file to write, NAME.safetensors"},
    ),
    "download": (
        "Fetch a file of weights from the Hugging Face hub into its cache; an interrupted download is continued. "
        'Needs pip install "anystyle[hub]".',
        {"name": "a row of `anystyle weights`"},
    ),
}
"""What each subcommand does, and its arguments; ``list`` is the default."""


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle weights``."""
    given = words_of(words)
    if given and given[0] in COMMANDS:
        about, positional = COMMANDS[given[0]]
        parser = new_parser(f"weights {given[0]}", about)
        for name, text in positional.items():
            parser.add_argument(name, metavar=name.upper(), help=text)
        {"verify": verify, "convert": convert, "download": download}[given[0]](parse(parser, given[1:]))
        return
    parser = new_parser(
        "weights",
        "Without arguments, or with `list`: every known file of weights, what for, licence, size, source, checksum, "
        "and where it is or was looked for.",
        epilog="anystyle weights {verify,convert,download} --help: check, convert or fetch a file.",
    )
    parser.add_argument("name", nargs="*", help="only these rows")
    print("\n".join(listing(parse(parser, given[1:] if given[:1] == ["list"] else given).name)))


def listing(names: Sequence[str]) -> Iterator[str]:
    """The table: a block of lines for each row."""
    from anystyle.vision import weights

    known = weights.files()
    for name in set(names) - set(known):
        raise UserError(unknown("file of weights, or command,", name, [*known, *COMMANDS]))
    for name in names or known:
        entry = known[name]
        searched = list(weights.candidates(name))
        path = next((path for path in searched if path.is_file()), None)
        size = "" if entry.size is None else f", {_readable(entry.size)}"
        yield f"{name}: {'found' if path else 'missing'}{size}\n  for      {entry.purpose}"
        yield f"  licence  {entry.license}\n  from     {entry.source}"
        if entry.sha256 is not None:
            yield f"  sha256   {entry.sha256}{'…' if len(entry.sha256) < 64 else ''}"
        yield f"  file     {path or entry.file}"
        if path is None:
            yield f"  looked   {', '.join(map(str, searched))}"
    yield f"\nLooked in, in this order: {', '.join(map(str, weights.folders()))}, packages that carry a file,"
    yield "the Hugging Face cache" + ("." if weights.has_hub() else ' (not looked in: pip install "anystyle[hub]").')
    yield f"Folders of your own: set {weights.FOLDERS}, separated as in PATH."


def _readable(size: int) -> str:
    power = min(3, (len(str(size)) - 1) // 3)
    return f"{size / 1000**power:.3g} {('B', 'kB', 'MB', 'GB')[power]}"


def verify(arguments: argparse.Namespace) -> None:
    """Print what a file of weights holds, if it is whole."""
    from anystyle.commands._weights_file import checksum, existing, recognise
    from anystyle.vision import bpe, weights

    path = existing(arguments.file)
    digest = checksum(path)
    if path.name == weights.row("clip_vocabulary").file:
        holds = (f"a vocabulary of {len(bpe.load(path, 49408).ids) + 2} tokens",)
    else:
        holds = recognise(path).holds
    print("\n".join([f"{path} is whole", *(f"  {line}" for line in holds), f"  sha256 {digest}"]))


def convert(arguments: argparse.Namespace) -> None:
    """Write a checkpoint's tensors into a safetensors file that names its source."""
    from anystyle.commands._weights_file import existing, recognise
    from anystyle.io.checkpoint import save_tensors, sha256

    out, path = Path(arguments.out), existing(arguments.file)
    if out.suffix != ".safetensors":
        raise UserError(f"the result is called {out}; let its name end in .safetensors")
    if out.exists() and out.samefile(path):
        raise UserError(f"{out} is the file that is read; give the result another name")
    known = recognise(path)
    if known.layout == "anystyle":
        raise UserError(f"{path} is a file that anystyle wrote; there is nothing to convert")
    holds = "; ".join(known.holds)
    provenance = {"file": path.name, "sha256": sha256(path), "converted_by": f"anystyle {version('anystyle')}"}
    described = {"layout": known.layout, "holds": holds, "provenance": json.dumps(provenance, sort_keys=True)}
    save_tensors(out, {key: tensor.contiguous() for key, tensor in known.state.items()}, {"format": "pt", **described})
    print(f"{out}: {holds}")


def download(arguments: argparse.Namespace) -> None:
    """Fetch a file of weights from the Hugging Face hub."""
    from anystyle.vision import weights

    name = arguments.name
    try:
        path = weights.find(name)
    except weights.MissingWeights:
        path = weights.download(name)
    if weights.verified(name, path) is False:
        raise UserError(f"{path} is not the published {name}; get it again from {weights.row(name).source}")
    print(path)


if __name__ == "__main__":
    run(main)
