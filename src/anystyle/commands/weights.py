"""Which checkpoints there are, where each comes from and where it was looked for; verify, convert, download one."""

import argparse
import json
from collections.abc import Iterator, Sequence
from importlib.metadata import version
from pathlib import Path

from anystyle.commands._flags import new_parser, parse
from anystyle.commands._run import run, words_of
from anystyle.errors import UserError, did_you_mean

SUBCOMMANDS = ("list", "verify", "convert", "download")


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle weights list``."""
    words = new_parser(
        "weights",
        "Without arguments, or with `list`: every known file of weights, what for, licence, size, source, "
        "checksum, and where it is or was looked for.",
        epilog="anystyle weights verify FILE says what a file holds and whether it is whole; anystyle weights convert "
        "FILE OUT.safetensors keeps its tensors alone; anystyle weights download NAME fetches one from the Hugging "
        'Face hub (pip install "anystyle[hub]").',
    )
    words.add_argument("name", nargs="*", help="only these rows")
    return words


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle weights``."""
    given = words_of(words)
    if given and given[0] in SUBCOMMANDS[1:]:
        {"verify": verify, "convert": convert, "download": download}[given[0]](given[1:])
        return
    if given[:1] == ["list"]:
        given = given[1:]
    print("\n".join(listing(parse(parser(), given).name)))


def listing(names: Sequence[str]) -> Iterator[str]:
    """The table: a block of lines a row.

    Raises:
        UserError: A name is no row.
    """
    from anystyle.perception import weights

    known = weights.files()
    for name in names:
        if name not in known:
            near = did_you_mean(name, [*known, *SUBCOMMANDS])
            raise UserError(f"no weights are called '{name}'.{near} Available: {', '.join(known)}")
    for name in names or known:
        entry = known[name]
        searched = list(weights.candidates(name))
        path = next((path for path in searched if path.is_file()), None)
        size = "" if entry.size is None else f", {readable(entry.size)}"
        yield f"{name}: {'found' if path else 'missing'}{size}"
        yield f"  for      {entry.purpose}"
        yield f"  licence  {entry.license}"
        yield f"  from     {entry.source}"
        if entry.sha256 is not None:
            yield f"  sha256   {entry.sha256}{'…' if len(entry.sha256) < 64 else ''}"
        yield f"  file     {path or entry.file}"
        if path is None:
            yield f"  looked   {', '.join(map(str, searched))}"
    yield ""
    yield from _where()


def _where() -> Iterator[str]:
    import importlib.util

    from anystyle.perception import weights

    hub = importlib.util.find_spec("huggingface_hub") is not None
    yield f"Looked in, in this order: {', '.join(map(str, weights.folders()))}, packages that carry a file,"
    yield "the Hugging Face cache" + ("." if hub else ' (not looked in: pip install "anystyle[hub]").')
    yield f"Folders of your own: set {weights.FOLDERS}, separated as in PATH."


def readable(size: int) -> str:
    """A number of bytes for people."""
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size >= scale:
            return f"{size / scale:.3g} {unit}"
    return f"{size} B"


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


if __name__ == "__main__":
    run(main)
