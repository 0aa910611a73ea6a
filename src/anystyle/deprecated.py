"""Names that have moved: they are found at their old places for one more minor version."""

import importlib
import tomllib
import warnings
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any


@cache
def moved_classes() -> dict[str, str]:
    """Paths of classes that have moved, and the present ones; those that end in ``.`` are of packages."""
    return tomllib.loads(Path(__file__).with_name("moved.toml").read_text(encoding="utf-8"))


def present(path: str) -> str:
    """The present path of a class, which may have moved."""
    for old, new in moved_classes().items():
        if path == old or (old.endswith(".") and path.startswith(old)):
            return new + path[len(old) :]
    return path


def moved(old: str, new: str, **renamed: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of the module ``old``, whose names are in the module ``new`` now, some of them renamed."""

    def find(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(new), renamed.get(name, name))
        warnings.warn(f"{old}.{name} is {new}.{renamed.get(name, name)} now", DeprecationWarning, stacklevel=2)
        return value

    return find
