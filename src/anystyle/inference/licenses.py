"""Under which terms weights were given, and what these mean for what is made with them."""

from collections.abc import Iterator, Mapping
from typing import Any

from anystyle.perception import weights

_OPEN = ("Apache", "MIT", "BSD", "CC0", "CC-BY-4.0")
_CLOSED = ("NC", "non-commercial", "noncommercial", "research")


def licenses(loaded: Mapping[str, Any]) -> dict[str, dict[str, str]]:
    """By part of the model: its file, the terms it was given under, and what they mean for a result.

    Args:
        loaded: What was loaded, as :func:`anystyle.inference.assemble.assemble` says it: by part, with ``file``.
    """
    terms = {row.file: row.license for row in weights.files().values()}
    files = {part: str(entry["file"]) for part, entry in loaded.items()}
    return {
        part: {"file": file, "license": terms.get(file, "not stated"), "means": meaning(terms.get(file))}
        for part, file in files.items()
    }


def meaning(license: str | None) -> str:
    """What a licence of weights means for a scene made with them, in a sentence; no legal advice."""
    if license is not None and any(word in license for word in _CLOSED):
        return "results may not be used commercially"
    if license is not None and license.startswith(_OPEN):
        return "results may be used freely; whoever passes the weights on keeps their notice"
    return "the terms are not known here; ask whoever published the weights before results are passed on"


def lines(terms: Mapping[str, Mapping[str, str]]) -> Iterator[str]:
    """For a file or a caption: a line for each part."""
    for part, entry in terms.items():
        yield f"{part}: {entry['file']}, {entry['license']}: {entry['means']}"


def report_entry(provenance: Mapping[str, object]) -> dict[str, dict[str, str]]:
    """The terms of what a report's provenance says was loaded; empty where it says nothing."""
    loaded = provenance.get("weights")
    return licenses(loaded) if isinstance(loaded, dict) else {}
