"""Design, run, analyse and plan user studies."""

import importlib
import sys
from collections.abc import Sequence

from anystyle.commands._flags import parse
from anystyle.commands._run import run, words_of
from anystyle.errors import UserError, did_you_mean

SUBCOMMANDS = {
    "design": "from folders of results to a study: sets, positions, orders, pictures",
    "form": "the page that participants see: one file, or served with answers kept in SQLite",
    "analyze": "from answers to tests, tables, figures and a report",
    "power": "by simulation: power and false positives of each test, participants needed",
}


def main(words: Sequence[str] | None = None) -> None:
    """Run ``anystyle study``."""
    given = words_of(words)
    if not given or given[0] in ("-h", "--help", "help"):
        rows = "\n".join(f"  {name:<8} {text}" for name, text in SUBCOMMANDS.items())
        print(f"usage: anystyle study COMMAND ...\n\n{__doc__}\n\n{rows}\n\nanystyle study COMMAND --help says more.")
        return
    if given[0] not in SUBCOMMANDS:
        known = ", ".join(SUBCOMMANDS)
        raise UserError(
            f"no study command is named {given[0]!r}.{did_you_mean(given[0], SUBCOMMANDS)} Commands: {known}"
        )
    module = importlib.import_module(f"anystyle.commands.study_{given[0]}")
    arguments = parse(module.parser(), given[1:])
    module.command(arguments)


if __name__ == "__main__":
    run(lambda: main(sys.argv[1:]))
