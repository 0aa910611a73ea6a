"""What was written about images, by file name."""

from pathlib import Path

import msgspec

from anystyle.documents import parse_json, read_text

_FORM = '{"image": "...", "text": "..."}'


class _Entry(msgspec.Struct):
    """A line of JSON Lines."""

    image: str
    text: str


def read_captions(path: Path) -> dict[str, str]:
    """Captions by image name, from JSON Lines or from lines ``name;text``.

    Raises:
        ValueError: The file cannot be read; the message names the line.
    """
    lines = read_text(path, what="file of captions").splitlines()
    captions: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        if path.suffix.lower() in (".jsonl", ".json"):
            entry: _Entry = parse_json(line, _Entry, source=f"line {number} of {path}", what=_FORM)
            name, text = entry.image, entry.text
        else:
            name, separator, text = line.partition(";")
            if not separator:
                raise ValueError(f"line {number} of {path} has no semicolon; 'image;text' is expected")
        captions[name.strip()] = text.strip()
    return captions
