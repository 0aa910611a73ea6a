"""What the licences of weights mean for the scenes that are made with them."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from anystyle.vision.weights.table import files

_MEANINGS = {
    True: "results may not be used commercially",
    False: "results may be used freely; redistributed weights keep their notice",
    None: "the terms are not known; ask the publisher of the weights before you share results",
}
_BINDING = ("NC", "non-commercial", "noncommercial", "research")
_FREE = ("Apache", "MIT", "BSD", "CC0", "CC-BY-4.0")


@dataclass(frozen=True)
class License:
    """The licence of a file of weights; no legal advice."""

    name: str
    binds: bool | None
    """Whether results may not be used commercially; ``None`` where the terms are not known."""

    @classmethod
    def named(cls, name: str | None) -> "License":
        """The licence that a table of weights names.

        Example:
            >>> [License.named(name).binds for name in ("CC-BY-NC-4.0", "Apache-2.0", "see the record")]
            [True, False, None]
        """
        if name is None:
            return cls("not stated", None)
        bound = any(word in name for word in _BINDING)
        return cls(name, True if bound else False if name.startswith(_FREE) else None)

    @property
    def meaning(self) -> str:
        """What it means for a scene, in a sentence."""
        return _MEANINGS[self.binds]


def licenses(loaded: object) -> dict[str, dict[str, str]]:
    """For each part that was loaded from a ``file``: the file, its licence, and what that means for a result."""
    names = {entry.file: entry.license for entry in files().values()}
    found: dict[str, dict[str, str]] = {}
    for part, entry in loaded.items() if isinstance(loaded, Mapping) else ():
        terms = License.named(names.get(file := str(entry["file"])))
        found[part] = {"file": file, "license": terms.name, "means": terms.meaning}
    return found


def license_meaning(license: str | None) -> str:
    """What a licence of weights means for a scene made with them, in a sentence; no legal advice."""
    return License.named(license).meaning


def license_lines(terms: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """A line for each part of :func:`licenses`, for a file's header or a caption."""
    for part, entry in terms.items():
        yield f"{part}: {entry['file']}, {entry['license']}: {entry['means']}"


def binding(lines: Iterable[str]) -> tuple[str, ...]:
    """Those of :func:`license_lines`, as files hold them, whose licence binds results; others concern the weights."""
    return tuple(line for line in lines if line.endswith(_MEANINGS[True]))
