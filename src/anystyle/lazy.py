"""Packages whose names are imported when they are first asked for."""

import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any


def stub(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__`` and ``__all__`` of a package with the names that the stub beside its file imports.

    The stub has lines ``from .module import Name as Name``, which type checkers read.
    """
    tree = ast.parse(Path(file).with_suffix(".pyi").read_bytes())
    imports = [statement for statement in tree.body if isinstance(statement, ast.ImportFrom)]
    homes = {alias.name: statement.module for statement in imports for alias in statement.names}

    def named(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home = homes[name]
        if home is None:  # a module of the package
            return importlib.import_module(f"{package}.{name}")
        value = getattr(importlib.import_module(f"{package}.{home}"), name)
        setattr(sys.modules[package], name, value)
        return value

    return named, lambda: sorted(homes), sorted(homes)
