"""Reading JSON, YAML, TOML and text from outside against a declared shape.

A reader returns a value of the shape that it asked for, or raises one line that names the file, the key and what was
expected. Only regular files of bounded size, depth and number of values are read; numbers are finite and of 64 bits.
"""

import codecs
import math
import os
import re
import stat
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from pickle import UnpicklingError
from typing import Any, Literal, TypeVar

import msgspec

from anystyle.errors import UserError, one_line

T = TypeVar("T")

Number = float | Literal["inf", "-inf"] | None
"""A number as JSON can hold it: ``None`` is not a number, and infinities are words."""


def stored_number(value: float) -> Number:
    """A number as JSON can hold it."""
    return value if math.isfinite(value) else None if math.isnan(value) else "inf" if value > 0 else "-inf"


def mapped(value: Any, leaf: Callable[[Any], Any]) -> Any:
    """Nested lists and mappings with ``leaf`` applied to every other value."""
    if isinstance(value, Mapping):
        return {key: mapped(part, leaf) for key, part in value.items()}
    return [mapped(part, leaf) for part in value] if isinstance(value, (list, tuple)) else leaf(value)


def plain(value: Any) -> Any:
    """A value of nested lists and tables as JSON can hold it."""
    return mapped(value, lambda part: stored_number(part) if isinstance(part, float) else part)


def as_number(score: Number) -> float:
    """The inverse of :func:`stored_number`."""
    return math.nan if score is None else float(score)


# Limits of bytes, nested levels and values; the parser of YAML is slow, and what its aliases repeat counts each time.
MAX_BYTES, MAX_YAML = 64 << 20, 1 << 20
MAX_DEPTH = 48
MAX_PARTS, MAX_YAML_PARTS = 2_000_000, 100_000


_INSTEAD = re.compile(rb"\s*(?:(version https://git-lfs)|<!doctype html|<html)", re.IGNORECASE)


def regular(path: str | Path, *, most: int | None = MAX_BYTES, what: str = "file") -> Path:
    """The path, if it is a regular file of at most ``most`` bytes: no folder, pipe, device or circular link."""
    path = Path(path)
    try:
        state = path.stat()
    except FileNotFoundError:
        raise UserError(f"there is no {what} {path}") from None
    except (OSError, ValueError) as error:  # links in a circle, names that no system can hold
        raise UserError(f"{path} cannot be read ({getattr(error, 'strerror', error)})") from None
    if not stat.S_ISREG(state.st_mode):
        raise UserError(f"{path} is not a regular file; a {what} is expected")
    if most is not None and state.st_size > most:
        raise UserError(f"{path} has {state.st_size:,} bytes; a {what} of at most {most:,} is expected")
    if state.st_size < 1 << 20 and os.access(path, os.R_OK) and (found := _INSTEAD.match(path.read_bytes())):
        way = "fetch it with git lfs pull" if found[1] else "download the file, not its page"
        raise UserError(f"{path} is a {'Git LFS pointer' if found[1] else 'web page'} and not the {what} itself; {way}")
    return path


def read_bytes(path: str | Path, *, most: int = MAX_BYTES, what: str = "file") -> bytes:
    """The content of a regular file of at most ``most`` bytes."""
    try:
        with regular(path, most=most, what=what).open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror})") from None


def read_text(path: str | Path, *, most: int = MAX_BYTES, what: str = "text file") -> str:
    """The content of a regular file as UTF-8 text; a byte-order mark is dropped."""
    try:
        return read_bytes(path, most=most, what=what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is not UTF-8 text (at byte {error.start}); a {what} is expected") from None


def read_json(path: str | Path, shape: type[T] | Any, *, what: str = "JSON file") -> T:
    """A JSON file, called ``what`` in messages, as a value of a type that msgspec knows, such as a dataclass."""
    return parse_json(read_bytes(path, what=what).removeprefix(codecs.BOM_UTF8), shape, source=str(path), what=what)


def kept_json(path: str | Path, shape: type[T] | Any) -> T | None:
    """The content of a JSON file of an earlier run; ``None`` where it is absent or damaged."""
    try:
        return read_json(path, shape)
    except UserError:
        return None


def parse_json(text: str | bytes, shape: type[T] | Any, *, source: str, what: str = "JSON") -> T:
    """JSON text, such as the header of another file, as a value of a shape."""
    return _shaped(lambda: msgspec.json.decode(text), shape, source, what)


def read_toml(path: str | Path, shape: type[T] | Any, *, what: str = "TOML file") -> T:
    """A TOML file as a value of a shape."""
    text = read_text(path, most=MAX_YAML, what=what)
    return _shaped(lambda: tomllib.loads(text), shape, str(path), what)


def read_yaml(path: str | Path, shape: type[T] | Any = Any, *, what: str = "YAML file", limit: bool = True) -> T:
    """A YAML file as a value of a shape; scalars are parsed as OmegaConf does, and interpolations stay text.

    Without ``limit`` numbers may be infinite.
    """
    import yaml
    from omegaconf import OmegaConf

    text = read_text(path, most=MAX_YAML, what=what)

    def parse() -> Any:
        value = yaml.safe_load(text)
        _check(value, MAX_YAML_PARTS, limit)  # first: aliases that repeat each other grow without bound when copied
        return OmegaConf.to_container(OmegaConf.create(text)) if isinstance(value, (dict, list)) else value

    return _shaped(parse, shape, str(path), what, limit=limit)


def fit(value: Any, shape: type[T] | Any, *, source: str, what: str = "document") -> T:
    """A value of plain lists, tables, texts and numbers as one of a shape."""
    return _shaped(lambda: value, shape, source, what)


_REASONS: dict[type[Exception], str] = {
    RecursionError: f"it is nested deeper than {MAX_DEPTH} levels",
    UnpicklingError: "it is damaged, or holds more than tensors and plain values",
}
"""What is told of errors whose own text would be of no use."""


def _shaped(parse: Callable[[], Any], shape: Any, source: str, what: str, *, limit: bool = True) -> Any:
    with parsing(source, what):
        value = parse()
        _check(value, MAX_PARTS, limit)
        return msgspec.convert(value, shape)


@contextmanager
def parsing(source: str | Path, what: str) -> Iterator[None]:
    """Refuse a file in one line if the block fails: what is damaged makes parsers raise nearly anything.

    A :class:`UserError` of the block, which names the file itself, stays as it is.
    """
    try:
        yield
    except (UserError, ImportError, MemoryError):
        raise
    except Exception as error:
        reason = _REASONS.get(type(error), "")
        with suppress(UnicodeError):  # libraries in C++ quote bytes of the file
            told = one_line(error).replace("`", "'").replace("'$'", "the top").replace("'$.", "'")[:300]
            if isinstance(error, KeyError):  # of a name, or with a sentence in quotes
                told = told.strip("'\"") if " " in told else f"it lacks {told}"
            reason = reason or told
        raise UserError(f"{source} is not a valid {what} ({reason or type(error).__name__})") from None


def _check(value: Any, parts: int, limit: bool) -> None:
    """Refuse values that are nested too deep, too many, infinite, or whole numbers of more than 64 bits."""
    stack: list[tuple[Any, int]] = [(value, 0)]
    count = 0
    while stack:
        item, depth = stack.pop()
        count += 1
        if depth > MAX_DEPTH:
            raise ValueError(f"it is nested deeper than {MAX_DEPTH} levels")
        if count > parts:
            raise ValueError(f"more than {parts:,} values")
        if isinstance(item, (dict, list, tuple)):
            inside = chain.from_iterable(item.items()) if isinstance(item, dict) else item
            stack.extend((part, depth + 1) for part in inside)
        elif limit and isinstance(item, float) and not math.isfinite(item):
            raise ValueError(f"the number {item}, where finite ones are expected")
        elif isinstance(item, int) and not -(1 << 63) <= item < 1 << 63:
            raise ValueError("a whole number of more than 64 bits")
