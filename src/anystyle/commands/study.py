"""Design, run, analyse and plan user studies."""

import importlib
import sys
from collections.abc import Sequence

from anystyle.commands._flags import parse, subcommand
from anystyle.commands._run import run, words_of

SUBCOMMANDS = {
    "design": "from folders of results to a study: sets, positions, orders, pictures",
    "form": "the page that participants see: one file, or served with answers kept in SQLite",
    "analyze": "from answers to tests, tables, figures and a report",
    "power": "by simulation: power and false positives of each test, participants needed",
}


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle study``."""
    given = words_of(words)
    name = subcommand("study", __doc__, SUBCOMMANDS, given)
    if name is not None:
        module = importlib.import_module(f"anystyle.commands.study_{name}")
        module.command(parse(module.parser(), given[1:]))


if __name__ == "__main__":
    run(lambda: main(sys.argv[1:]))
