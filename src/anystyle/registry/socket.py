"""What every contract shares, and the contract of a command; needs nothing but the standard library."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar


class Socket:
    """A class that plugins inherit from."""

    many: ClassVar[bool] = False
    """For a kind that a package declares: whether a configuration holds several plugins of it at once."""
    runtime: ClassVar[tuple[str, ...]] = ()
    """For a kind that a package declares: constructor arguments that are passed by name, and that are no options."""

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Options of an instance that can be checked in seconds; the constructor's defaults, unless overridden.

        A large network returns a few thin layers, a data set the path of a small sample of its format that it has
        just written.

        Args:
            folder: An empty folder to write into, there for as long as the instance is used.
        """
        return {}


class Command(Socket, ABC):
    """A word of the command line, ``anystyle NAME ...``; the first line of its docstring is its description."""

    @abstractmethod
    def __call__(self, words: Sequence[str]) -> None:
        """Run the command.

        Args:
            words: What follows the command's name.

        Raises:
            UserError: The words make no sense; ends in one line and exit status 2.
        """
