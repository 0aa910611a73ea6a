"""What a scene was made of, from the notes of its files, as each format's standard has it.

A note of :mod:`anystyle.pipeline.provenance` is a table in JSON behind a prefix; all others are lines for people.
"""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

from anystyle.io.documents import fit
from anystyle.pipeline.provenance import MADE_OF, tables
from anystyle.types import StyledScene

XMP = "KHR_xmp_json_ld"
_GIVEN = ("photographs", "film", "scene")
_SCHEMA_TYPES = {"photographs": "ImageObject", "image": "ImageObject", "scene": "3DModel", "network": "MediaObject"}


@dataclass(frozen=True)
class _Work:
    """What is read of a table."""

    kind: str = ""
    names: list[str] = field(default_factory=list)
    text: str = ""
    views: int = 0
    sha256: str = ""
    title: str = ""
    author: str = ""
    year: str = ""
    license: str = ""
    source: str = ""
    anystyle: str = ""

    @property
    def name(self) -> str:
        return self.text or ", ".join(self.names)

    @property
    def line(self) -> str:
        """For people; of many files the first and the last."""
        shown = [self.names[0], "…", self.names[-1]] if len(self.names) > 3 else self.names
        kind = f"{len(self.names)} {self.kind}" if self.kind == "photographs" else self.kind
        digest = self.sha256 and f"SHA-256 {self.sha256[:12]}…"
        facts = (self.text and f"“{self.text}”", *shown, self.title, self.author, self.year, self.license, digest)
        return f"{kind}: {', '.join(filter(None, facts))}"


def lines_of(notes: Iterable[str]) -> list[str]:
    """Notes that are lines already."""
    return [note for note in notes if not note.startswith(MADE_OF)]


def joined_notes(lines: Sequence[str], made_of: object) -> tuple[str, ...]:
    """Lines and tables as notes again."""
    found = made_of if isinstance(made_of, list) else []
    return (*lines, *(MADE_OF + json.dumps(table) for table in found if isinstance(table, dict)))


def readable(notes: Sequence[str]) -> list[str]:
    """All notes as lines; lines on licences stand for the networks."""
    works = [work for work in _works(notes) if work.kind not in ("network", "software")]
    return [*lines_of(notes), *(work.line for work in works)]


def xmp_packet(scene: StyledScene, media_type: str) -> dict[str, Any] | None:
    """XMP in JSON-LD as ``KHR_xmp_json_ld`` restricts it; ``None`` where nothing is told."""
    works = _works(scene.notes)
    if not works:
        return None
    styles = [work.name for work in works if work.kind in ("image", "text")]
    packet: dict[str, Any] = {
        "@context": {
            "dc": "http://purl.org/dc/elements/1.1/",
            "rdf": "http://www.w3.org/1999/02/22-rdf-syntax-ns#",
            "xmp": "http://ns.adobe.com/xap/1.0/",
        },
        "@id": "",
        "dc:title": _alternative(scene.title or scene.styles[-1][0]),
        "dc:format": media_type,
        "dc:rights": _alternative("\n".join(_rights(scene.notes, works))),
        "dc:source": "; ".join(f"{work.name} (SHA-256 {work.sha256})" for work in works if work.kind in _GIVEN),
        "dc:relation": {"@set": list(dict.fromkeys(work.source for work in works if work.source))},
        "xmp:CreatorTool": _tool(works),
    }
    return packet | ({"dc:description": _alternative("styles: " + "; ".join(styles))} if styles else {})


def json_ld(scene: StyledScene) -> dict[str, Any] | None:
    """The scene as schema.org describes a 3D model and what it is based on; ``None`` where nothing is told."""
    works = _works(scene.notes)
    if not works:
        return None
    return {
        "@context": "https://schema.org",
        "@type": "3DModel",
        "name": scene.title or scene.styles[-1][0],
        "creditText": _tool(works),
        "isBasedOn": [_creative_work(work) for work in works if work.kind != "software"],
        "usageInfo": "\n".join(_rights(scene.notes, works)),
    }


def _works(notes: Iterable[str]) -> list[_Work]:
    return [fit(table, _Work, source="a note on provenance") for table in tables(notes)]


def _tool(works: Sequence[_Work]) -> str:
    return f"anystyle {next((work.anystyle for work in works if work.anystyle), '')}".strip()


def _rights(notes: Iterable[str], works: Iterable[_Work]) -> list[str]:
    """Licences of what was given, and the notes that are lines, such as licences of networks."""
    given = [f"{work.title or work.name}: {work.license}" for work in works if work.kind != "network" and work.license]
    return [*given, *lines_of(notes)]


def _alternative(text: str) -> dict[str, Any]:
    return {"@type": "rdf:Alt", "rdf:_1": {"@language": "x-default", "@value": text}}


def _creative_work(work: _Work) -> dict[str, Any]:
    known = {
        "name": work.title or work.name,
        "alternateName": work.names,
        "text": work.text,
        "sha256": work.sha256,
        "author": work.author,
        "dateCreated": work.year,
        "license": work.license,
        "url": work.source,
        "genre": work.kind,
    }
    kind = _SCHEMA_TYPES.get(work.kind, "CreativeWork")
    return {"@type": kind, **{name: value for name, value in known.items() if value}}
