"""Which photograph is meant by a name in another program's file."""

import re
import unicodedata
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain, takewhile
from pathlib import Path, PurePath, PurePosixPath

from anystyle.errors import UserError
from anystyle.paths import text_of

ENCODINGS = ("gb18030", "cp932", "big5", "cp949", "cp1251", "cp437", "cp1252", "latin-1")
"""Of names that were not written as UTF-8."""
_DIFFERENCES = ("", "", "their suffix", "upper and lower case or Unicode's form", "their encoding")
"""Between two names, from the best agreement on; that a program leaves the suffix out is nothing to tell."""


def matched(stored: Collection[str], images: Sequence[Path]) -> dict[Path, str]:
    """The stored name of each image that has one.

    Folders count first, from the image's own upwards, as far as the stored name has them; then the names: equal, equal
    without suffix, equal but for upper and lower case or Unicode's form, and equal in another encoding.

    Args:
        stored: Names or paths as another program wrote them; bytes that are not UTF-8 are escaped as surrogates.
        images: Image files.

    Raises:
        UserError: Two names fit an image equally well, or two images fit one name.
    """
    index: dict[tuple[str, ...], list[str]] = {}
    folders = set[tuple[str, ...]]()
    for name in stored:
        for path in _readings(name):
            folders.add(_folders(path))
            for key in _keys(path.name):
                index.setdefault((key,), []).append(name)
                index.setdefault((key, *(_folders(path)[:1] or ("",))), []).append(name)
    claims: dict[str, list[tuple[tuple[bool, int, int], Path]]] = {}
    for image in dict.fromkeys(images):
        above = _folders(image.absolute())
        keys = {key for path in _readings(image.name) for key in _keys(path.name)}
        near = [index[key, folder] for key in keys for folder in {"", *above[:1]} if (key, folder) in index]
        names = set(chain.from_iterable(near or (index.get((key,), ()) for key in keys)))
        ranked = sorted((_rank(name, image), name) for name in names)
        # A program that knows the image's folder found no camera for images that it names only in other folders.
        if not ranked or (ranked[0][0][0] and any(folder == above[: len(folder)] for folder in folders)):
            continue
        (rank, name), *others = ranked
        if others and others[0][0] == rank:
            raise UserError(f"{image} may be {name} or {others[0][1]}; rename it, or give the folder as it was")
        claims.setdefault(name, []).append((rank, image))
    for name, claimed in claims.items():
        claimed.sort()
        if len(claimed) > 1 and claimed[0][0] == claimed[1][0]:
            raise UserError(f"{name} may be {claimed[0][1]} or {claimed[1][1]}; leave one of them out")
    return {claimed[0][1]: name for name, claimed in claims.items()}


def differences(pairs: Mapping[Path, str]) -> str:
    """A sentence on how matched names differ from those of their images; empty where they do not."""
    told: dict[Path, list[str]] = {}
    for image, name in pairs.items():
        elsewhere, _, level = _rank(name, image)
        told[image] = [*(["their folder"] if elsewhere else []), *filter(None, [_DIFFERENCES[level]])]
    kinds = list(dict.fromkeys(chain.from_iterable(told.values())))
    if not kinds:
        return ""
    image, *others = (image for image in told if told[image])
    shown = text_of(f"{image} is taken for {pairs[image]}")
    return f"the names of {1 + len(others)} of {len(pairs)} images differ in {' and '.join(kinds)}: {shown}"


def _rank(name: str, image: Path) -> tuple[bool, int, int]:
    """How badly names agree: whether folders differ, how few are the same, and an index of :data:`_DIFFERENCES`."""
    return min(_disagreement(path, image, number > 0) for number, path in enumerate(_readings(name)))


def _disagreement(stored: PurePath, image: Path, other_encoding: bool) -> tuple[bool, int, int]:
    wanted, above = _folders(stored), _folders(image.absolute())
    same = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(wanted, above, strict=False)))
    without_suffix = stored.name == image.stem or stored.stem == image.name
    alike = not _keys(stored.name).isdisjoint(_keys(image.name))
    agreements = (stored.name == image.name, without_suffix, stored.stem == image.stem, alike, True)
    return same < len(wanted), -same, 4 if other_encoding else agreements.index(True)


def _folders(path: PurePath) -> tuple[str, ...]:
    """The folders of a path, its own first; reduced copies in ``images_4`` lie where ``images`` would."""
    names = (_folded(part) for part in reversed(path.parts[:-1]) if part not in ("..", path.anchor))
    return tuple(re.sub(r"^images_\d+$", "images", name) for name in names)


def _keys(name: str) -> set[str]:
    """What a name has in common with those that it may be matched with."""
    return {_folded(name), _folded(PurePosixPath(name).stem)}


def _readings(name: str) -> Iterator[PurePosixPath]:
    """The path in a name, and those that its bytes are in other encodings."""
    for encoding in ("", *(() if name.isascii() else ENCODINGS)):
        with suppress(UnicodeError):
            text = name.encode("utf-8", "surrogateescape").decode(encoding) if encoding else name
            yield PurePosixPath(text.replace("\\", "/"))


def _folded(text: str) -> str:
    return unicodedata.normalize("NFC", text).casefold()
