"""The base class of all contracts; needs nothing but the standard library."""

from pathlib import Path
from typing import ClassVar


class Pluggable:
    """The base of contracts: what the plugins of a kind inherit from."""

    many: ClassVar[bool] = False
    """Whether a configuration holds several plugins of the kind at once."""
    runtime: ClassVar[tuple[str, ...]] = ()
    """Constructor arguments that are passed by name, and that are not options."""

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Options of an instance that can be checked in seconds; the constructor's defaults, unless overridden.

        A large network returns a few thin layers, a data set the path of a small sample of its format that it has
        just written.

        Args:
            folder: An empty folder to write into, there for as long as the instance is used.
        """
        return {}
