"""``anystyle study``: one of its commands."""

from collections.abc import Sequence

from anystyle.cli.arguments import subcommand
from anystyle.contracts import Command

SUBCOMMANDS = {
    "design": "from folders of results to a study: sets, positions, orders, pictures",
    "form": "the page that participants see, as one file that works offline",
    "analyze": "from answers to tests, tables, plots and a report",
    "power": "by simulation: power and false positives of each test, participants needed",
}


class StudyCommand(Command):
    """Design, run, analyse and plan user studies."""

    def __call__(self, words: Sequence[str]) -> None:
        if (name := subcommand("study", self.__doc__, SUBCOMMANDS, words)) is not None:
            from anystyle_study.commands import COMMANDS

            COMMANDS[name](words[1:])
