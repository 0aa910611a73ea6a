"""Fetch a file of weights from the Hugging Face hub."""

import argparse
from collections.abc import Sequence

from anystyle.commands._flags import parse


def parser() -> argparse.ArgumentParser:
    """The words of ``anystyle weights download``."""
    words = argparse.ArgumentParser(
        prog="anystyle weights download",
        description="Fetch a file of weights from the Hugging Face hub into its cache, with a progress bar; an "
        "interrupted download goes on where it stopped.",
        allow_abbrev=False,
    )
    words.add_argument("name", metavar="NAME", help="a row of `anystyle weights`")
    return words


def main(words: Sequence[str]) -> int:
    """Run ``anystyle weights download``.

    Returns:
        The exit status.

    Raises:
        ValueError: The hub does not have it, or cannot be reached.
        ImportError: ``huggingface_hub`` is missing; the message names the extra.
    """
    arguments = parse(parser(), words)
    from anystyle.perception import weights

    entry = weights.row(arguments.name)
    try:
        path = weights.find(arguments.name)
    except FileNotFoundError:
        path = weights.download(arguments.name)
    if weights.verified(arguments.name, path) is False:
        raise ValueError(f"{path} is not the published {arguments.name}; get it again from {entry.source}")
    print(path)
    return 0
