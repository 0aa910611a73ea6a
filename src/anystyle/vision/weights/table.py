"""The rows of ``weights.toml``: where each file of weights comes from, under what licence, and what that means."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated

from msgspec import Meta

from anystyle.errors import UserError, check_known
from anystyle.io.documents import read_toml
from anystyle.registry.packages import packages

TABLE = "weights.toml"
"""The file of a package's rows: one table for each, with the fields of :class:`WeightsFile`."""

_BINDING = ("NC", "non-commercial", "noncommercial", "research")
_FREE = ("Apache", "MIT", "BSD", "CC0", "CC-BY-4.0")


@dataclass(frozen=True)
class WeightsFile:
    """One file of weights."""

    file: str
    purpose: str
    license: str
    source: str  # the publisher's address, or how it was made
    sha256: str | None = None  # in hexadecimal; as many leading digits as its publisher states
    bundled: bool = False  # comes with the package of this row
    size: int | None = None  # of the file in bytes, where its publisher states it
    tensors: int | None = None  # bytes of the tensors that the network has, computed; the file may hold more
    # On the Hugging Face hub: owner/repository/path.
    hub: Annotated[str, Meta(pattern=r"^(?!.*(--|\.\.))\w[\w.-]*/\w[\w.-]*/[^/\0][^\0]*$")] | None = None
    # In an installed package: package/path.
    package: Annotated[str, Meta(pattern=r"^[A-Za-z_]\w*/[^\0]+$")] | None = None


def files() -> dict[str, WeightsFile]:
    """Every row by name: those of the table beside this module, then those of plugins."""
    known = dict(rows_of(Path(__file__).with_name(TABLE)))
    for package in packages():
        for name, entry in rows_of(package / TABLE).items():
            if known.setdefault(name, entry) != entry:
                raise UserError(f"{package / TABLE} names {name!r}, the name of another row; rename it")
    return known


@cache
def rows_of(path: Path) -> dict[str, WeightsFile]:
    """The rows of one table, by name; none where there is no such file."""
    return read_toml(path, dict[str, WeightsFile], what="table of weights") if path.is_file() else {}


def row(name: str) -> WeightsFile:
    """The row of a name."""
    known = files()
    check_known("file of weights", [name], known)
    return known[name]


def meaning(name: str) -> str:
    """What the licence of a file of weights means for a scene, in a sentence; no legal advice.

    Example:
        >>> meaning("CC-BY-NC-4.0")
        'results may not be used commercially'
    """
    if any(word in name for word in _BINDING):
        return "results may not be used commercially"
    if name.startswith(_FREE):
        return "results may be used freely; redistributed weights keep their notice"
    return "the terms are not known; ask the publisher of the weights before you share results"


def licenses(loaded: object) -> dict[str, dict[str, str]]:
    """For each part that was loaded from a ``file``: the file, its licence, and what that means for a result."""
    names = {entry.file: entry.license for entry in files().values()}
    found: dict[str, dict[str, str]] = {}
    for part, entry in loaded.items() if isinstance(loaded, Mapping) else ():
        terms = names.get(file := str(entry["file"]), "not stated")
        found[part] = {"file": file, "license": terms, "means": meaning(terms)}
    return found


def license_lines(terms: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """A line for each part of :func:`licenses`, for a file's header or a caption."""
    for part, entry in terms.items():
        yield f"{part}: {entry['file']}, {entry['license']}: {entry['means']}"
