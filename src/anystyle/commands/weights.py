"""Which checkpoints there are, where each comes from and where it was looked for; verify, convert, download one."""

import argparse
from collections.abc import Iterator, Sequence

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
        from anystyle.commands import _weights_actions

        getattr(_weights_actions, given[0])(given[1:])
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


if __name__ == "__main__":
    run(main)
