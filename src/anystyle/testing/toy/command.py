"""A greeting: the smallest command."""
# ruff: noqa: T201

from collections.abc import Sequence

from anystyle.cli.arguments import new_parser, parse
from anystyle.contracts import Command


class ToyCommand(Command):
    """Greet somebody."""

    def __call__(self, words: Sequence[str]) -> None:
        parser = new_parser("toy", self.__doc__)
        parser.add_argument("name", nargs="?", default="world", help="who is greeted (default: world)")
        parser.add_argument("--loud", action="store_true", help="with an exclamation mark")
        arguments = parse(parser, words)
        print(f"hello, {arguments.name}{'!' if arguments.loud else '.'}")
