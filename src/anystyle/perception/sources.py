"""The weights that a figure rests on: published ones, or a stand-in."""

import logging
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Literal

from anystyle.io.checkpoint import sha256
from anystyle.perception import weights

log = logging.getLogger(__name__)

Weights = Literal["auto", "published", "stand_in"]
"""``published`` requires published weights, ``stand_in`` takes a stand-in, ``auto`` does so where they are missing."""


@dataclass(frozen=True)
class Source:
    """The weights of one network.

    Args:
        network: Its name in :func:`anystyle.perception.weights.files`.
        file: The name of the file that was read; empty if none was.
        sha256: Of its content, in hexadecimal; empty if there is no file.
        stand_in: The name of what stands in for the network, if anything does. Its figures are comparable with those
            of the same stand-in alone.
    """

    network: str
    file: str = ""
    sha256: str = ""
    stand_in: str | None = None

    @property
    def identity(self) -> str:
        """The same for the same weights."""
        return f"{self.network}:{self.stand_in}:{self.sha256}"


def locate(network: str, choice: Weights) -> Path | None:
    """The published weights of a network; ``None`` where a stand-in takes its place.

    Raises:
        FileNotFoundError: They are missing, and no stand-in is allowed.
    """
    if choice == "stand_in":
        return None
    try:
        return weights.find(network)
    except FileNotFoundError as error:
        if choice == "published":
            raise
        log.warning("a stand-in takes the place of %s, its figures are not comparable: %s", network, error)
        return None


def published(network: str, file: Path) -> Source:
    """The source of a network that was read from a file."""
    status = file.stat()
    return Source(network=network, file=file.name, sha256=_digest(file, status.st_mtime_ns, status.st_size))


def bundled(network: str, stand_in: str) -> Source:
    """The source of a stand-in that rests on the bundled texture network."""
    texture = published("texture", weights.find("texture"))
    return replace(texture, network=network, stand_in=stand_in)


def stand_ins(figures: Iterable[str], *sources: Source) -> dict[str, str]:
    """For each of the figures that rest on these networks, the stand-ins among them; empty where there is none."""
    names = ", ".join(dict.fromkeys(source.stand_in for source in sources if source.stand_in))
    return dict.fromkeys(figures, names) if names else {}


def checksums(*sources: Source) -> dict[str, str]:
    """The SHA-256 of every file that was read, by its name."""
    return {source.file: source.sha256 for source in sources if source.file}


@cache
def _digest(file: Path, changed: int, size: int) -> str:
    return sha256(file)
