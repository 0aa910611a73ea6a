"""Where the files live that come with the package: beside ``src/`` in a checkout, inside the package in a wheel."""

from pathlib import Path

PACKAGE = Path(__file__).parent
_IN_WHEEL = PACKAGE / "_shared"
SHARED = _IN_WHEEL if _IN_WHEEL.is_dir() else PACKAGE.parent.parent
"""The folder that holds ``conf/`` and ``plugins/``."""

CONF = SHARED / "conf"
PLUGINS = SHARED / "plugins"
ASSETS = PACKAGE / "assets"


def shown(path: Path) -> str:
    """A path as people read it: without what leads to the checkout, the package or the current folder."""
    for base in (SHARED, Path.cwd()):
        if path.is_relative_to(base):
            return path.relative_to(base).as_posix()
    return str(path)
