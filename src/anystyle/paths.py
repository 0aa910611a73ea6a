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


def natural(name: str) -> list[tuple[int, str]]:
    """A key that sorts ``view2`` before ``view10``."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name.casefold()) if part]
