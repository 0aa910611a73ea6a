"""Which weights a network has: published ones, or a stand-in."""

import logging
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal

from anystyle.io.checkpoint import sha256
from anystyle.types import Source
from anystyle.vision.weights.search import MissingWeights, find

log = logging.getLogger(__name__)

Weights = Literal["auto", "published", "stand_in"]
"""``published`` requires published weights, ``stand_in`` takes a stand-in, ``auto`` does so where they are missing."""


def locate(network: str, choice: Weights) -> Path | None:
    """The published weights of a network; ``None`` where a stand-in is chosen or replaces missing ones."""
    if choice == "stand_in":
        return None
    try:
        return find(network)
    except MissingWeights as error:
        if choice == "published":
            raise
        log.warning("a stand-in replaces %s, its figures are not comparable: %s", network, error)
        return None


def published(network: str, file: Path) -> Source:
    """The source of a network that was read from a file."""
    status = file.stat()
    return Source(network=network, file=file.name, sha256=_digest(file, status.st_mtime_ns, status.st_size))


@cache
def _digest(file: Path, changed: int, size: int) -> str:
    return sha256(file)


def bundled(network: str, stand_in: str) -> Source:
    """The source of a stand-in that rests on the bundled texture network."""
    return replace(published("texture", find("texture")), network=network, stand_in=stand_in)
