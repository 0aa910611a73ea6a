"""Where the files live that come with the package, and how paths are shown and sorted."""

import re
from pathlib import Path

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
