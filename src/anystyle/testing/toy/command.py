"""A greeting: the smallest command."""
# ruff: noqa: T201

import argparse
from collections.abc import Sequence
from typing import NoReturn

from anystyle.contracts import Command
from anystyle.errors import UserError


class Parser(argparse.ArgumentParser):
    """Words that make no sense end in one line, as those of all commands do."""

    def error(self, message: str) -> NoReturn:
        raise UserError(f"{message}; see {self.prog} --help")


class ToyCommand(Command):
    """Greet somebody."""

    def __call__(self, words: Sequence[str]) -> None:
        parser = Parser("anystyle toy", description=self.__doc__)
        parser.add_argument("name", nargs="?", default="world", help="who is greeted (default: world)")
        parser.add_argument("--loud", action="store_true", help="with an exclamation mark")
        arguments = parser.parse_args(words)
        print(f"hello, {arguments.name}{'!' if arguments.loud else '.'}")
