"""What was written about images, by file name."""

import json
from pathlib import Path


def read_captions(path: Path) -> dict[str, str]:
    """Captions by image name, from JSON Lines or from lines ``name;text``.

    Raises:
        ValueError: The file cannot be read; the message names the line.
    """
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ValueError(f"captions {path} cannot be read ({error})") from None
    captions: dict[str, str] = {}
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        if path.suffix.lower() in (".jsonl", ".json"):
            name, text = _json_line(line, f"line {number} of {path}")
        else:
            name, separator, text = line.partition(";")
            if not separator:
                raise ValueError(f"line {number} of {path} has no semicolon; 'image;text' is expected")
        captions[name.strip()] = text.strip()
    return captions


def _json_line(line: str, line_name: str) -> tuple[str, str]:
    try:
        entry = json.loads(line)
        name, text = entry["image"], entry["text"]
    except (ValueError, KeyError, TypeError):
        raise ValueError(f'{line_name} is not of the form {{"image": "...", "text": "..."}}') from None
    if not isinstance(name, str) or not isinstance(text, str):
        raise ValueError(f'{line_name} is not of the form {{"image": "...", "text": "..."}}')
    return name, text
