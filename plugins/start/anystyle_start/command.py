"""``anystyle start``: the page on which scenes are made."""

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

from anystyle.cli.arguments import new_parser, parse
from anystyle.cli.run import show
from anystyle.contracts import Command
from anystyle_start.server import StartServer


def parser() -> argparse.ArgumentParser:
    """The flags of ``anystyle start``."""
    flags = new_parser(
        "start", "Open a page on which scenes are made of what is dropped there; anystyle view opens it, too."
    )
    flags.add_argument("--port", type=int, default=8080, help="0 takes a free one (default: %(default)s)")
    flags.add_argument("--keep", type=Path, default=Path("out/view"), help="stores scenes (default: %(default)s)")
    return flags


class Start(Command):
    """A page on which scenes are made of what is dropped, shown and kept."""

    def __call__(self, words: Sequence[str]) -> None:
        arguments = parse(parser(), words)
        with StartServer(arguments.keep, arguments.port) as server:
            print(f"{server.url} makes scenes of what is dropped there; Ctrl-C ends it", flush=True)
            show(server.url)
            while True:
                time.sleep(3600)
