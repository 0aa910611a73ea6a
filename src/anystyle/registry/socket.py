"""What every contract shares; needs nothing but the standard library."""

from pathlib import Path


class Socket:
    """A class that plugins inherit from."""

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Options of an instance that can be checked in seconds; the constructor's defaults, unless a plugin says else.

        A large network returns a few thin layers, a data set the path of a small sample of its format that it has
        just written.

        Args:
            folder: An empty folder to write into, there for as long as the instance is used.
        """
        return {}
