"""The one door for documents from outside: JSON, YAML, TOML and text, read against a declared shape.

Whatever a file holds, a reader gets a value of the shape that it asked for, or one line that names the file, the key
and what was expected. Nothing else is opened than regular files of a bounded size, and nothing that is nested deeper
or has more parts than a document of this project could have; numbers are finite and fit into 64 bits.
"""

import math
import stat
import tomllib
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import msgspec

from anystyle.errors import UserError, one_line

T = TypeVar("T")

Positive = Annotated[float, msgspec.Meta(gt=0)]
Count = Annotated[int, msgspec.Meta(ge=0)]
Figure = float | Literal["inf", "-inf"] | None
"""A number as JSON can hold it: ``None`` is not a number, and infinities are words."""


def as_figure(value: float) -> Figure:
    """A number as JSON can hold it."""
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return value


def plain(value: Any) -> Any:
    """A value of nested lists and tables as JSON can hold it."""
    if isinstance(value, float):
        return as_figure(value)
    if isinstance(value, Mapping):
        return {key: plain(part) for key, part in value.items()}
    return [plain(part) for part in value] if isinstance(value, (list, tuple)) else value


def as_number(figure: Figure) -> float:
    """The number that :func:`as_figure` was given."""
    return math.nan if figure is None else float(figure)


MAX_BYTES = 64 << 20
"""The largest document that is read; documents of a study and tables of answers are far smaller."""
MAX_YAML = 1 << 20
"""The largest YAML file, for its parser is slow."""
MAX_DEPTH = 48
"""How deep lists and tables may lie in each other."""
MAX_PARTS = 2_000_000
"""How many values a document may hold, those that an alias repeats counted as often as they appear."""
MAX_YAML_PARTS = 100_000


def regular(path: str | Path, *, most: int | None = MAX_BYTES, what: str = "file") -> Path:
    """A path that is a regular file of a bounded size: no folder, pipe, device or link to itself.

    Args:
        path: Of the file.
        most: Bytes that it may have; ``None`` for any number.
        what: What it is called in messages.

    Raises:
        UserError: It is something else, or there is none.
    """
    path = Path(path)
    try:
        state = path.stat()
    except FileNotFoundError:
        raise UserError(f"there is no {what} {path}") from None
    except (OSError, ValueError) as error:  # links in a circle, names that no system can hold
        reason = error.strerror if isinstance(error, OSError) else error
        raise UserError(f"{path} cannot be read ({reason})") from None
    if not stat.S_ISREG(state.st_mode):
        raise UserError(f"{path} is no regular file; a {what} is expected")
    if most is not None and state.st_size > most:
        raise UserError(f"{path} has {state.st_size:,} bytes; a {what} of at most {most:,} is expected")
    return path


def read_bytes(path: str | Path, *, most: int = MAX_BYTES, what: str = "file") -> bytes:
    """The content of a regular file.

    Raises:
        UserError: It is none, too large, or may not be read.
    """
    path = regular(path, most=most, what=what)
    try:
        with path.open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise UserError(f"{path} cannot be read ({error.strerror})") from None


def read_text(path: str | Path, *, most: int = MAX_BYTES, what: str = "text file") -> str:
    """The content of a regular file as UTF-8 text; a byte-order mark is dropped.

    Raises:
        UserError: It is no such file.
    """
    try:
        return read_bytes(path, most=most, what=what).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise UserError(f"{path} is not UTF-8 text (at byte {error.start}); a {what} is expected") from None


def read_json(path: str | Path, shape: type[T] | Any, *, what: str = "JSON file") -> T:
    """A JSON file as a value of a shape.

    Args:
        path: Of the file.
        shape: A type that msgspec knows: built-in ones, dataclasses, typed dictionaries, ``Annotated`` bounds.
        what: What the file is called in messages, with what makes it again.

    Raises:
        UserError: It is no JSON, or does not fit the shape; the message names the file, the key and what is expected.
    """
    return parse_json(read_bytes(path, what=what), shape, source=str(path), what=what)


def kept_json(path: str | Path, shape: type[T] | Any) -> T | None:
    """What an earlier run kept, as a value of a shape; ``None`` where it is absent or damaged, to be made again."""
    try:
        return read_json(path, shape)
    except UserError:
        return None


def parse_json(text: str | bytes, shape: type[T] | Any, *, source: str, what: str = "JSON") -> T:
    """JSON text, such as the header of another file, as a value of a shape.

    Raises:
        UserError: As :func:`read_json`.
    """
    return _shaped(lambda: msgspec.json.decode(text), shape, source, what)


def read_toml(path: str | Path, shape: type[T] | Any, *, what: str = "TOML file") -> T:
    """A TOML file as a value of a shape.

    Raises:
        UserError: As :func:`read_json`.
    """
    text = read_text(path, most=MAX_YAML, what=what)
    return _shaped(lambda: tomllib.loads(text), shape, str(path), what)


def read_yaml(path: str | Path, shape: type[T] | Any = Any, *, what: str = "YAML file", limit: bool = True) -> T:
    """A YAML file as a value of a shape; scalars are what Hydra takes them for, and interpolations stay text.

    Args:
        path: Of the file.
        shape: As for :func:`read_json`.
        what: What it is called in messages.
        limit: Whether numbers are bounded; a configuration may hold infinities, which its schema judges.

    Raises:
        UserError: As :func:`read_json`.
    """
    import yaml
    from omegaconf._utils import get_yaml_loader

    text = read_text(path, most=MAX_YAML, what=what)
    parse = lambda: yaml.load(text, Loader=get_yaml_loader())  # noqa: E731  (a safe loader)
    return _shaped(parse, shape, str(path), what, parts=MAX_YAML_PARTS, limit=limit)


def fit(value: Any, shape: type[T] | Any, *, source: str, what: str = "document") -> T:
    """A value of plain lists, tables, texts and numbers as one of a shape.

    Raises:
        UserError: As :func:`read_json`.
    """
    return _shaped(lambda: value, shape, source, what)


def _shaped(
    parse: Callable[[], Any], shape: Any, source: str, what: str, *, parts: int = MAX_PARTS, limit: bool = True
) -> Any:
    try:
        value = parse()
        _check(value, parts, limit)
        return msgspec.convert(value, shape)
    except RecursionError:
        raise UserError(f"{source} is nested deeper than {MAX_DEPTH} levels; expected a {what}") from None
    except Exception as error:
        # Parsers of damaged text raise nearly anything.
        reason = one_line(error).replace("`", "'").replace("'$'", "the top").replace("'$.", "'")
        raise UserError(f"{source} is no {what} ({reason[:300] or type(error).__name__})") from None


def _check(value: Any, parts: int, limit: bool) -> None:
    """Refuse what is too deep, too large, or holds numbers that are infinite or of more than 64 bits.

    Values that are shared, as those of YAML's aliases, count each time, so one that holds itself is too deep.
    """
    stack: list[tuple[Iterable[Any], int]] = [((value,), 0)]
    count = 0
    while stack:
        items, depth = stack.pop()
        for item in items:
            count += 1
            if depth > MAX_DEPTH:
                raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
            if count > parts:
                raise ValueError(f"more than {parts:,} values")
            if isinstance(item, dict):
                stack.append((item.keys(), depth + 1))
                stack.append((item.values(), depth + 1))
            elif isinstance(item, (list, tuple)):
                stack.append((item, depth + 1))
            elif limit and isinstance(item, float) and not abs(item) < float("inf"):
                raise ValueError(f"the number {item}, where finite ones are expected")
            elif isinstance(item, int) and not -(1 << 63) <= item < 1 << 63:
                raise ValueError("a whole number of more than 64 bits")
