"""Which weights a network has, for reports."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Source:
    """The weights of one network.

    Figures of a stand-in for a network are comparable with those of the same stand-in only.
    """

    network: str
    file: str = ""  # its name, empty if none was read
    sha256: str = ""  # of its content, in hexadecimal
    stand_in: str | None = None

    @property
    def identity(self) -> str:
        """Equal for equal weights."""
        return f"{self.network}:{self.stand_in}:{self.sha256}"
