"""Files of data sets: pictures at any depth, and lists by lines."""

import json
from collections.abc import Collection, Iterable
from pathlib import Path

from anystyle.data.images import SUFFIXES
from anystyle.io.atomic import atomic_path


def pictures_below(root: Path, suffixes: Collection[str] = SUFFIXES) -> list[Path]:
    """The pictures of a folder at any depth, in order."""
    return sorted(path for path in root.rglob("*") if path.suffix.lower() in suffixes and path.is_file())


def write_lines(path: Path, lines: Iterable[str]) -> None:
    """Write a text file, whole or not at all."""
    with atomic_path(path) as temporary:
        temporary.write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")


def caption_row(image: str, text: str) -> str:
    """A line of ``captions.jsonl``."""
    return json.dumps({"image": image, "text": text}, ensure_ascii=False)
