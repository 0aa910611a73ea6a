"""The plugin under test, and how an instance of it is made."""

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Generic, TypeVar

import torch
from torch import nn
from torch.nn.modules.module import register_module_parameter_registration_hook

from anystyle.testing.check import Unavailable, attempt, expect

T = TypeVar("T")
R = TypeVar("R")

MOST_PARAMETERS = 32_000_000
"""What can be built, copied and run in seconds on one thread."""


@dataclass(frozen=True)
class Subject(Generic[T]):
    """A plugin with the options it is checked with.

    Args:
        cls: The plugin's class.
        options: Of the constructor.
        runtime: What the framework passes by name; a constructor that does not name it does not get it.
        memory: What checks share; see :meth:`once`.
    """

    cls: type[T]
    options: Mapping[str, Any] = field(default_factory=dict)
    runtime: Mapping[str, Any] = field(default_factory=dict)
    memory: dict[str, Any] = field(default_factory=dict, repr=False)

    def build(self, seed: int = 0, **runtime: Any) -> T:
        """A new instance, with weights drawn from ``seed``; ``runtime`` goes before the subject's own.

        Raises:
            ContractError: It cannot be built, or is too large to be checked.
                Unavailable: It needs a package or a file that this machine lacks.
        """
        named = inspect.signature(self.cls).parameters
        passed = {name: value for name, value in {**self.runtime, **runtime}.items() if name in named}
        options = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
        change = "make the constructor work with its defaults, or return options that work from `example`"
        with attempt(f"{self.cls.__name__}({options})", change=change), seeded(seed), _limited(self.cls):
            try:
                return self.cls(**self.options, **passed)
            except ModuleNotFoundError:
                raise
            except (ImportError, FileNotFoundError) as error:
                # The house's rule for optional dependencies and for weights: the message says what to get.
                raise Unavailable(f"it cannot be checked here: {error}") from error

    def once(self, name: str, make: Callable[[], R]) -> R:
        """What ``make`` gives, made by the first check that asks for ``name``; none may change it."""
        if name not in self.memory:
            self.memory[name] = make()
        return self.memory[name]

    @cached_property
    def instance(self) -> T:
        """One instance that checks share; a check that changes it builds its own."""
        return self.build()


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Draw from torch's global generator as after ``seed``, and leave it as it was."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


@contextmanager
def _limited(cls: type) -> Iterator[None]:
    # Stops a full-size network while it is being built, before it has taken gigabytes and minutes.
    total = 0

    def count(module: nn.Module, name: str, parameter: nn.Parameter | None) -> None:
        nonlocal total
        total += 0 if parameter is None else parameter.numel()
        expect(
            total <= MOST_PARAMETERS,
            given=f"a network of more than {MOST_PARAMETERS:,} parameters",
            expected="one that can be checked in seconds",
            change=f"override `{cls.__name__}.example` so that it returns the options of a few thin layers",
        )

    handle = register_module_parameter_registration_hook(count)
    try:
        yield
    finally:
        handle.remove()
