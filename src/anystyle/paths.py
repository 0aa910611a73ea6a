"""Where the files live that come with the package, and how paths are shown, sorted and named."""

import os
import re
import unicodedata
from collections.abc import Sequence
from itertools import chain, count
from pathlib import Path, PurePath

PACKAGE = Path(__file__).parent
_IN_WHEEL = PACKAGE / "_shared"
SHARED = _IN_WHEEL if _IN_WHEEL.is_dir() else PACKAGE.parent.parent
"""The folder that holds ``conf/`` and ``plugins/``: the checkout, or one inside the package in a wheel."""

CONF = SHARED / "conf"
PLUGINS = SHARED / "plugins"
ASSETS = PACKAGE / "assets"


def shown(path: Path) -> str:
    """A path to display: relative to the checkout, the package or the current folder where it is below one."""
    for base in (SHARED, Path.cwd()):
        if path.is_relative_to(base):
            return path.relative_to(base).as_posix()
    return str(path)


def text_of(name: str) -> str:
    """A name as text that every file can hold: with escapes for bytes that are not UTF-8."""
    return name.encode(errors="backslashreplace").decode()


def expanded(path: str | Path) -> Path:
    """A path with ``~`` as the home folder; as it is where nobody has such a name."""
    try:
        return Path(path).expanduser()
    except RuntimeError:
        return Path(path)


def inside(folder: Path, name: str) -> Path | None:
    """The path of a name that a file gives; ``None`` where it leads out of the folder, or no file can have it."""
    try:
        return folder / name if folder.resolve() in (folder / name).resolve().parents else None
    except (OSError, RuntimeError, ValueError):  # links in a circle, NUL bytes
        return None


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts ``view2`` before ``view10``."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name.casefold()) if part]


def folders_in(folder: Path) -> list[Path]:
    """The folders directly inside a folder, in natural order, without hidden ones."""
    return sorted((path for path in folder.glob("[!.]*") if path.is_dir()), key=lambda path: natural(path.name))


def distinct(names: Sequence[str], separator: str = "_") -> list[str]:
    """The same names, with a number behind those that occurred before, upper or lower case: ``1``, ``1_2``, ``1_3``."""
    taken: dict[str, str] = {}
    for name in names:
        numbered = (f"{name}{separator}{number}" for number in count(2))
        candidate = next(one for one in chain([name], numbered) if one.casefold() not in taken)
        taken[candidate.casefold()] = candidate
    return list(taken.values())


def file_name(name: str) -> str:
    """A name as that of a file, without suffix, on any system: what separates folders or is reserved is a hyphen."""
    letters = re.sub(r'[<>:"/\\|?*\x00-\x1f\x7f]+', "-", unicodedata.normalize("NFC", name)).strip(". ")
    return letters.encode()[:200].decode(errors="ignore").rstrip(". ") or "view"


def short_names(paths: Sequence[PurePath]) -> list[str]:
    """The last parts of paths, as few as tell them apart, as distinct names: ``0001``, or ``cam0_0001``."""
    different = len({str(path).casefold() for path in paths})
    names = [path.name for path in paths]
    for length in range(1, 1 + max((len(path.parts) for path in paths), default=0)):
        names = ["_".join(path.parts[-length:]) for path in paths]
        if len({name.casefold() for name in names}) == different:
            break
    return distinct([name.encode("utf-8", "replace").decode() for name in names])


def names_below(paths: Sequence[Path]) -> list[str]:
    """The paths of files below the folder that holds them all: ``0001.png``, or ``cam0/0001.png``."""
    whole = [path.absolute() for path in paths]
    top = os.path.commonpath([path.parent for path in whole]) if whole else ""
    return [path.relative_to(top).as_posix() for path in whole]
