"""Say what a file of weights holds, and whether it is whole."""

import argparse
from collections.abc import Sequence

from anystyle.commands._flags import parse


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle weights verify``."""
    words = argparse.ArgumentParser(
        prog="anystyle weights verify",
        description="Say what a file of weights holds, and whether it is whole: every tensor that its network needs, "
        "no other, of the right shape; and its checksum where one is published. Nothing in the file is executed.",
        allow_abbrev=False,
    )
    words.add_argument("file", metavar="FILE", help="a file, or a row of `anystyle weights`")
    return words


def main(words: Sequence[str]) -> int:
    """Run ``anystyle weights verify``.

    Returns:
        The exit status.

    Raises:
        ValueError: The file is not whole, not what it is called, or of no known kind.
    """
    arguments = parse(parser(), words)
    from anystyle.commands._weights_file import checksum, existing, recognise
    from anystyle.perception import bpe, weights

    path = existing(arguments.file)
    digest = checksum(path)
    if path.name == weights.row("clip_vocabulary").file:
        tokens = len(bpe.load(path, 49408).ids) + 2
        lines = [f"a vocabulary of {tokens} tokens"]
    else:
        lines = list(recognise(path).holds)
    print(f"{path} is whole")
    for line in lines:
        print(f"  {line}")
    print(f"  sha256 {digest}")
    return 0
