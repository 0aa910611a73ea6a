"""The plugin under test, and how an instance of it is made."""

import inspect
import tempfile
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

import pytest
from torch import nn

from anystyle.errors import MissingExtra, UserError
from anystyle.registry.catalog import base_of
from anystyle.types.seeds import seeded

T = TypeVar("T")

MAX_PARAMETERS = 32_000_000
"""What can be built, copied and run in seconds on one thread."""


@dataclass(frozen=True, eq=False)
class Subject(Generic[T]):
    """A plugin with the options it is checked with; hashed by identity, so that results on it can be cached."""

    kind: str
    cls: type[T]
    options: Mapping[str, Any]

    def build(self, seed: int = 0, **runtime: Any) -> T:
        """A new instance; skips the test where a package or file is missing that the plugin needs.

        What the framework passes by name is given to constructors that name it; ``seed`` seeds torch meanwhile.
        """
        named = inspect.signature(self.cls).parameters
        passed = {name: value for name, value in runtime.items() if name in named}
        try:
            with seeded(seed):
                built = self.cls(**self.options, **passed)
        except (MissingExtra, FileNotFoundError) as error:
            pytest.skip(f"it cannot be checked here: {error}")
        size = sum(parameter.numel() for parameter in built.parameters()) if isinstance(built, nn.Module) else 0
        remedy = "let `example` return the options of a smaller one"
        assert size <= MAX_PARAMETERS, f"a network of more than {MAX_PARAMETERS:,} parameters; {remedy}"
        return built

    @cached_property
    def instance(self) -> T:
        """One instance that promises share; one that changes it builds its own."""
        return self.build()


def subject(kind: str, cls: type[T], options: Mapping[str, Any] | None = None) -> Subject[T]:
    """A class under test, with given constructor options or else those that its ``example`` returns."""
    base = base_of(kind)
    if not issubclass(cls, base):
        raise UserError(f"{cls.__name__} is not a {kind}; make it inherit from {base.__module__}.{base.__qualname__}")
    if options is not None:
        return Subject(kind, cls, options)
    folder = tempfile.TemporaryDirectory(prefix="anystyle-")
    tested = Subject(kind, cls, dict(cls.example(Path(folder.name))))
    weakref.finalize(tested, folder.cleanup)
    return tested
