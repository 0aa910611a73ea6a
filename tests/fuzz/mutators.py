"""What may have happened to a file: cut, flipped, replaced, or true to its form and wrong in its content."""

import json
import os
import random
import struct
import zipfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

Mutator = Callable[[random.Random, bytes, str], bytes | None]
"""From a file's bytes and suffix to others; ``None`` where it does not apply."""

DEEP = 10_000
VALUES: tuple[Any, ...] = (
    None, True, 0, -1, 1 << 70, 10**400, 1e308, "", "a", "../../../x", "\ud7ff", "${oc.env:HOME}", "=1+1", [], {},
    [[]], [None], {"a": None}, {"_target_": "os.system"}, float("nan"), float("inf"), -float("inf"),
)  # fmt: skip


def cut(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """The file ends early."""
    return data[: draw.randrange(len(data) + 1)]


def flip(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """Some bytes are others."""
    changed = bytearray(data)
    for _ in range(draw.choice((1, 1, 2, 8, 64))):
        if changed:
            changed[draw.randrange(len(changed))] = draw.choice((0, 255, draw.randrange(256)))
    return bytes(changed)


def splice(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """A part stands twice, or is missing."""
    start, end = sorted(draw.randrange(len(data) + 1) for _ in range(2))
    return data[:end] + data[start:] if draw.random() < 0.5 else data[:start] + data[end:]


def foreign(draw: random.Random, data: bytes, suffix: str) -> bytes:
    """Something else altogether, under this name."""
    pairs = zip("abcdefghijklmnopqrstuvw", "bcdefghijklmnopqrstuvwx", strict=True)
    bomb = "a: &a [x, x]\n" + "".join(f"{after}: &{after} [*{name}, *{name}]\n" for name, after in pairs)
    vast = b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (9999999999, 17)}"
    return draw.choice(
        (
            b"", b"\0" * 64, b"null", b"[]", b"{}", b"3", b'"text"', b"\xff\xfe\xfa", b"%!PS-Adobe-3.0 EPSF-3.0\n",
            b"[" * DEEP, b'{"a":' * DEEP, b"PK\x03\x04", b"\x80\x04N.", bomb.encode(),
            b"a: !!python/object/apply:os.system [x]",
            b"- " * DEEP, os.urandom(64), vast,
            b"SQLite format 3\0" + b"\0" * 100, b"a = " + b"[" * DEEP, b"1e999", b"NaN", b"<svg/>", b"\xef\xbb\xbf{}",
        )
    )  # fmt: skip


def value(draw: random.Random, data: bytes, suffix: str) -> bytes | None:
    """A value of a document is another: of another type, infinite, huge, deep."""
    if suffix not in (".json", ".yaml", ".jsonl"):
        return None
    lines = data.split(b"\n") if suffix == ".jsonl" else [data]
    index = draw.randrange(len(lines))
    try:
        document = json.loads(lines[index]) if suffix != ".yaml" else __import__("yaml").safe_load(data)
    except ValueError:
        return None
    for _ in range(draw.choice((1, 1, 1, 3))):
        document = _replaced(draw, document)
    lines[index] = json.dumps(document).encode("utf-8", "surrogatepass")
    return b"\n".join(lines)


def _replaced(draw: random.Random, document: Any) -> Any:
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
        for key, part in items:
            places.append((node, key))
            walk(part)

    walk(document)
    if not places or draw.random() < 0.03:
        return draw.choice(VALUES)
    node, key = draw.choice(places)
    action = draw.random()
    if action < 0.15:
        del node[key]
    elif action < 0.2 and isinstance(node, dict):
        node[str(draw.choice(VALUES))] = node.pop(key)
    elif action < 0.25:
        node[key] = [node[key]]
    else:
        node[key] = draw.choice(VALUES)
    return document


def word(draw: random.Random, data: bytes, suffix: str) -> bytes | None:
    """A word or a number of a text is another."""
    if suffix == ".ply":
        head, end, rest = data.partition(b"end_header\n")
        changed = word(draw, head, ".txt")
        return None if changed is None else changed + end + rest
    if suffix not in (".txt", ".csv", ".toml", ".yaml", ".json", ".jsonl"):
        return None
    text = data.decode("utf-8", "replace")
    for mark in draw.sample(" ,;=\"\n:[]{}'", 12):
        parts = text.split(mark)
        if len(parts) > 1:
            odd = (
                "nan",
                "inf",
                "-1",
                "1e999",
                "9" * 400,
                "",
                "../../x",
                "null",
                "[",
                '"',
                "\0",
                "é" * 9000,
                "0x1",
                "- ",
            )
            parts[draw.randrange(len(parts))] = draw.choice(odd)
            return mark.join(parts).encode()
    return None


def array(draw: random.Random, data: bytes, suffix: str) -> bytes | None:
    """An array of another shape, type or value."""
    if suffix != ".npy":
        return None
    values = np.load(BytesIO(data))
    options: list[Any] = [
        values[:0], values[..., :1], values.ravel(), values[None], values * np.nan, values + np.inf,
        values.astype(np.complex64), values.astype("U8"), values.astype(bool), np.array([None, 1], object),
        values.astype(np.int8), -values, np.float64(3), values.astype(np.float16), np.zeros((0, 0)),
    ]  # fmt: skip
    buffer = BytesIO()
    np.save(buffer, draw.choice(options), allow_pickle=True)
    return buffer.getvalue()


def archive(draw: random.Random, data: bytes, suffix: str) -> bytes | None:
    """A zip archive one of whose entries is damaged, absent, or a bomb."""
    if data[:4] != b"PK\x03\x04":
        return None
    buffer, source = BytesIO(), zipfile.ZipFile(BytesIO(data))
    victim = draw.choice(source.namelist())
    with zipfile.ZipFile(buffer, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            if name == victim:
                change = draw.choice(("drop", "flip", "cut", "foreign", "array"))
                if change == "drop":
                    continue
                inner = {"flip": flip, "cut": cut, "foreign": foreign, "array": array}[change]
                content = inner(draw, content, Path(name).suffix) or b""
            target.writestr(name, content)
    return buffer.getvalue()


def header(draw: random.Random, data: bytes, suffix: str) -> bytes | None:
    """A safetensors file whose header says something else."""
    if suffix != ".safetensors":
        return None
    (length,) = struct.unpack("<Q", data[:8])
    document = json.loads(data[8 : 8 + length])
    metadata = document.setdefault("__metadata__", {})
    key = draw.choice(("part", "config", "base", "provenance", "omitted", "format", "tensor"))
    if key == "tensor":
        name = draw.choice([name for name in document if name != "__metadata__"])
        document[name + "x"] = document.pop(name)
    elif draw.random() < 0.2:
        metadata.pop(key, None)
    else:
        inner = json.loads(metadata[key]) if key in metadata and key not in ("part", "format") else None
        metadata[key] = json.dumps(_replaced(draw, inner) if inner else draw.choice(VALUES))
    text = json.dumps(document).encode()
    return struct.pack("<Q", len(text)) + text + data[8 + length :]


MUTATORS: tuple[tuple[Mutator, int], ...] = (
    (cut, 3), (flip, 6), (splice, 2), (foreign, 4), (value, 8), (word, 5), (array, 6), (archive, 5), (header, 6)
)  # fmt: skip


def special(draw: random.Random, path: Path) -> None:
    """Replace a file by what is no regular file: a pipe, a device, a folder, a link to itself, nothing."""
    path.unlink()
    kind = draw.choice(("pipe", "zero", "folder", "loop", "gone", "locked", "null"))
    if kind == "pipe":
        os.mkfifo(path)
    elif kind in ("zero", "null"):
        path.symlink_to(f"/dev/{kind}")
    elif kind == "folder":
        path.mkdir()
    elif kind == "loop":
        path.symlink_to(path.name)
    elif kind == "locked":
        path.write_bytes(b"x")
        path.chmod(0)


def mutate(draw: random.Random, path: Path) -> str:
    """Damage a file in one of the ways that fit it; returns the way's name."""
    if draw.random() < 0.04:
        special(draw, path)
        return "special"
    data = path.read_bytes()
    while True:
        (change,) = draw.choices([item for item, _ in MUTATORS], [weight for _, weight in MUTATORS])
        changed = change(draw, data, path.suffix)
        if changed is not None and changed != data:
            path.unlink()
            path.write_bytes(changed)
            return change.__name__
