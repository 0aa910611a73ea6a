"""XML from other programs: no document types, and so no entities."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path
from xml.etree.ElementTree import Element

from anystyle.errors import UserError
from anystyle.io.documents import read_text

MAX_BYTES = 256 << 20
"""The largest file that is read; Metashape's has 2 kB per photograph."""


def read_xml(path: Path, what: str) -> Element:
    """The root of an XML file."""
    text = read_text(path, most=MAX_BYTES, what=what)
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise UserError(f"{path} declares a document type, which a {what} does not have")
    try:
        return ElementTree.fromstring(text)
    except (ElementTree.ParseError, ValueError) as error:
        raise UserError(f"{path} is not a {what} ({error})") from None


def starts_with(path: Path, word: str) -> bool:
    """Whether the first kilobytes of a file hold a word."""
    with path.open("rb") as file:
        return word.encode() in file.read(4096)


def number(element: Element, name: str, default: float = 0.0) -> float:
    """The number in a child."""
    text = element.findtext(name)
    return default if text is None else float(text)


def numbers(text: str | None, count: int, what: str) -> list[float]:
    """So many numbers between blanks."""
    values = [float(word) for word in (text or "").split()]
    if len(values) != count:
        raise UserError(f"{what} has {len(values)} numbers, and {count} are expected")
    return values
