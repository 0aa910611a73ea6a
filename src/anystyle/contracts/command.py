"""The contract of a command."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from anystyle.registry.catalog import Pluggable


class Command(Pluggable, ABC):
    """A command, ``anystyle NAME ...``; the first line of its docstring is its description."""

    @abstractmethod
    def __call__(self, words: Sequence[str]) -> None:
        """Run the command.

        Args:
            words: What follows the command's name.

        Raises:
            UserError: The words make no sense; ends in one line and exit status 2.
        """
