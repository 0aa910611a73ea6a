"""Where a file of weights is searched, and fetched from if it is asked for; which of them a network has."""

import importlib.util
import logging
import os
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Literal

from anystyle import paths
from anystyle.errors import UserError, of_extra
from anystyle.io.checkpoint import sha256
from anystyle.paths import expanded
from anystyle.registry.packages import packages
from anystyle.types import Source
from anystyle.types.network import checksums as checksums
from anystyle.types.network import stand_ins as stand_ins
from anystyle.vision.weights.table import TABLE, row, rows_of

FOLDERS = "ANYSTYLE_WEIGHTS"
"""The environment variable that names folders of weights, separated as in ``PATH``."""

Weights = Literal["auto", "published", "stand_in"]
"""``published`` requires published weights, ``stand_in`` takes a stand-in, ``auto`` does so where they are missing."""

log = logging.getLogger(__name__)


class MissingWeights(UserError, FileNotFoundError):
    """A file of weights was not found; the message says where to get it and where to put it."""


def folders() -> tuple[Path, ...]:
    """The folders that are searched, in order: those of ``ANYSTYLE_WEIGHTS``, then the package's own."""
    return (*[expanded(folder) for folder in os.environ.get(FOLDERS, "").split(os.pathsep) if folder], paths.ASSETS)


def candidates(name: str) -> Iterator[Path]:
    """The paths at which a file is searched, in order: :func:`folders`, plugins, another package, the hub's cache."""
    entry = row(name)
    for folder in folders():
        yield folder / entry.file
    if entry.bundled:
        yield from (package / "assets" / entry.file for package in packages() if name in rows_of(package / TABLE))
    if entry.package is not None:
        package, _, inside = entry.package.partition("/")
        spec = importlib.util.find_spec(package)
        if spec is not None and spec.submodule_search_locations:
            yield Path(next(iter(spec.submodule_search_locations))) / inside
    if entry.hub is not None and has_hub():
        from huggingface_hub import try_to_load_from_cache  # pyright: ignore[reportMissingImports]

        owner, repository, path = entry.hub.split("/", 2)
        cached = try_to_load_from_cache(f"{owner}/{repository}", path)
        if isinstance(cached, str):
            yield Path(cached)


def find(name: str, path: str | Path | None = None) -> Path:
    """The file of the weights called ``name``: the given one, or one of :func:`candidates`, else `MissingWeights`."""
    searched = [expanded(path)] if path is not None else list(candidates(name))
    for candidate in searched:
        if candidate.is_file():
            return candidate
    entry = row(name)
    by_hub = f" (`anystyle weights download {name}` does)" if entry.hub else ""
    shown = ", ".join(map(str, searched)) + (", the Hugging Face cache" if entry.hub and has_hub() else "")
    put = "" if entry.package else f" and put it into a folder that {FOLDERS} names"  # a package is found where it is
    raise MissingWeights(
        f"the weights {name!r} are missing: get {entry.file} from {entry.source}{by_hub} ({entry.license}){put}; "
        f"looked for {shown}"
    )


def has_hub() -> bool:
    """Whether ``huggingface_hub`` is installed."""
    return importlib.util.find_spec("huggingface_hub") is not None


def download(name: str) -> Path:
    """Fetch a file from the Hugging Face hub into its cache; an interrupted download is continued."""
    entry = row(name)
    put = f"put it as {entry.file} into a folder that {FOLDERS} names"
    if entry.hub is None:
        found = f"get it from {entry.source} ({entry.license}) and {put}"
        raise UserError(f"the Hugging Face hub does not have {name!r}: {found}")
    hub = of_extra("huggingface_hub", f"downloading {name} needs", "hub")
    owner, repository, path = entry.hub.split("/", 2)
    try:
        return Path(hub.hf_hub_download(f"{owner}/{repository}", path))
    except OSError as error:
        reason = next(iter(str(error).strip().splitlines()), type(error).__name__)
        raise UserError(
            f"{entry.hub} cannot be fetched ({reason}); try again, or get it from {entry.source} elsewhere and {put}"
        ) from None


def verified(name: str, path: str | Path) -> bool | None:
    """Whether a file has the checksum that its publisher states; ``None`` if none is stated."""
    stated = row(name).sha256
    return None if stated is None else sha256(path).startswith(stated)


def locate(network: str, choice: Weights) -> Path | None:
    """The published weights of a network; ``None`` where a stand-in is chosen or replaces missing ones."""
    if choice == "stand_in":
        return None
    try:
        return find(network)
    except MissingWeights as error:
        if choice == "published":
            raise
        log.warning("a stand-in replaces %s, its scores are not comparable: %s", network, error)
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
