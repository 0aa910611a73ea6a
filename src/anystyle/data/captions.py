"""Captions of images."""

from pathlib import Path

import msgspec

from anystyle.errors import UserError
from anystyle.io.documents import parse_json, read_text


def captions_file(folder: Path) -> Path | None:
    """What describes a folder of images: ``captions.jsonl`` in it, or ``style_descriptions.txt`` in it or beside it."""
    places = (folder / "captions.jsonl", *(place / "style_descriptions.txt" for place in (folder, folder.parent)))
    return next((path for path in places if path.is_file()), None)


class _Line(msgspec.Struct):
    image: str
    text: str


def read_captions(path: Path) -> dict[str, str]:
    """Captions by image name, from JSON Lines or from lines ``name;text``."""
    captions: dict[str, str] = {}
    for number, line in enumerate(read_text(path, what="file of captions").splitlines(), start=1):
        if not line.strip():
            continue
        where = f"line {number} of {path}"
        if path.suffix.lower() in (".jsonl", ".json"):
            entry: _Line = parse_json(line, _Line, source=where, what='{"image": "...", "text": "..."}')
            name, text = entry.image, entry.text
        else:
            name, separator, text = line.partition(";")
            if not separator:
                raise UserError(f"{where} has no semicolon; 'image;text' is expected")
        captions[name.strip().replace("\\", "/")] = text.strip()
    return captions
