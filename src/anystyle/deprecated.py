"""Names that have moved: they are found at their old places for one more minor version."""

import importlib
import warnings
from collections.abc import Callable
from typing import Any


def moved(old: str, new: str, **renamed: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of the module ``old``, whose names are in the module ``new`` now, some of them renamed."""

    def find(name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(f"module {old!r} has no attribute {name!r}")
        value = getattr(importlib.import_module(new), renamed.get(name, name))
        warnings.warn(f"{old}.{name} is {new}.{renamed.get(name, name)} now", DeprecationWarning, stacklevel=2)
        return value

    return find
