"""What a figure rests on: published weights, or a stand-in that says so."""

import hashlib
import logging
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal

from anystyle.perception import weights

log = logging.getLogger(__name__)

Weights = Literal["auto", "published", "stand_in"]
"""``published`` needs the published weights, ``stand_in`` uses a stand-in, ``auto`` uses one where they are missing."""


@dataclass(frozen=True)
class Source:
    """The weights of one network.

    Args:
        network: What it is called among :data:`anystyle.perception.weights.FILES`.
        file: The name of the file that was read; empty if none was.
        sha256: Of its content, in hexadecimal; empty if there is no file.
        stand_in: What stands in for the network; ``None`` if nothing does. Figures of a stand-in are compared with
            nothing but figures of the same stand-in.
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
    """The published weights of a network; ``None`` where a stand-in shall take its place.

    Raises:
        FileNotFoundError: They are missing, and no stand-in is wanted.
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
    """The source that a file is."""
    status = file.stat()
    return Source(network=network, file=file.name, sha256=_digest(file, status.st_mtime_ns, status.st_size))


def bundled(network: str, stand_in: str) -> Source:
    """A stand-in that rests on the bundled network of textures."""
    own = published("texture", weights.find("texture"))
    return Source(network=network, file=own.file, sha256=own.sha256, stand_in=stand_in)


def stand_ins(figures: Iterable[str], *sources: Source) -> dict[str, str]:
    """For each of the figures that rest on these networks, the stand-ins among them; empty where there is none."""
    names = ", ".join(dict.fromkeys(source.stand_in for source in sources if source.stand_in))
    return dict.fromkeys(figures, names) if names else {}


def checksums(*sources: Source) -> dict[str, str]:
    """The SHA-256 of every file that was read, by its name."""
    return {source.file: source.sha256 for source in sources if source.file}


@cache
def _digest(file: Path, changed: int, size: int) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()
