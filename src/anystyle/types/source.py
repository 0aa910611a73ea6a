"""Which weights a network has, for reports."""

from collections.abc import Iterable
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


def stand_ins(figures: Iterable[str], *sources: Source) -> dict[str, str]:
    """For each of the figures that rest on these networks, the stand-ins among them; empty where there is none."""
    names = ", ".join(dict.fromkeys(source.stand_in for source in sources if source.stand_in))
    return dict.fromkeys(figures, names) if names else {}


def checksums(*sources: Source) -> dict[str, str]:
    """The SHA-256 of every file that was read, by its name."""
    return {source.file: source.sha256 for source in sources if source.file}
