"""Running the contract of one plugin."""
# ruff: noqa: T201

import importlib
import inspect
import io
import textwrap
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from types import ModuleType
from typing import Any

import pytest
import torch

from anystyle.registry.catalog import PluginError, base_of, catalog, location_in
from anystyle.testing import composition, declaration
from anystyle.testing.composition import compositions
from anystyle.testing.subject import Subject, subject


def promises(kind: str) -> list[Callable[[Any], None]]:
    """All that a plugin of a kind promises by itself, as functions that raise an error where it is broken.

    They are in the module ``testing.KIND`` of the package that declares the kind. Where the first promise of a module
    is broken, the others cannot be checked.
    """
    name = f"{base_of(kind).__module__.partition('.')[0]}.testing.{kind}"
    try:
        contract = importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise PluginError(f"the contract of {kind} has no tests: {error}; its package should have {name}") from error
    return [*promises_in(declaration), *promises_in(contract)]


def promises_in(module: ModuleType) -> list[Callable[[Any], None]]:
    """The promises of a module."""
    functions = (function for name, function in vars(module).items() if name.startswith("test_"))
    return [function for function in functions if function.__module__ == module.__name__]


def _checks(tested: Subject) -> Iterator[tuple[str, Callable[[Any], None], object]]:
    """Every promise in words, its function, and what that is called with."""
    for promise in promises(tested.kind):
        yield _words(promise), promise, tested
    for name, composed in compositions(tested).items():
        for promise in promises_in(composition):
            yield f"{_words(promise)} ({name})", promise, composed


def _words(promise: Callable[[Any], None]) -> str:
    return promise.__name__.removeprefix("test_").replace("_", " ")


def assert_contract(kind: str, cls: type, **options: Any) -> None:
    """Hold a class against the contract of its kind; for tests of plugins.

    The options of its constructor are by default those that its ``example`` returns. Backbones, placements and
    injectors are also composed with built-in plugins.
    """
    with one_thread():
        for _, promise, argument in _checks(subject(kind, cls, options or None)):
            promise(argument)


def check(kind: str, plugin: str | type) -> bool:
    """Run the contract of a plugin, the name of one in the catalog or a class, and print a line for each promise.

    Returns whether every promise is kept; ``False`` also where some could not be checked.
    """
    cls = catalog().find(kind, plugin).load() if isinstance(plugin, str) else plugin
    tested, start, counts, blocked = subject(kind, cls), time.perf_counter(), Counter[str](), False
    for words, promise, argument in _checks(tested):
        if blocked or (argument is not tested and counts["broken"]):
            counts["not checked"] += 1
            continue
        try:
            with one_thread(), warnings.catch_warnings(action="ignore"), redirect_stdout(io.StringIO()):
                promise(argument)
        except pytest.skip.Exception as skipped:
            counts["not checked"] += 1
            print(f"skipped  {words}\n{_indented(str(skipped))}")
        except (Exception, pytest.fail.Exception) as error:
            counts["broken"] += 1
            blocked = promise is promises_in(inspect.getmodule(promise))[0]  # pyright: ignore[reportArgumentType]
            told = " ".join(str(error).split())[:600]
            if not told or not isinstance(error, AssertionError | pytest.fail.Exception):
                told = f"{type(error).__name__}: {told}{location_in(error, cls.__module__)}"
            print(f"FAILED   {words}\n{_indented(inspect.getdoc(promise) or '')}\n{_indented(told)}")
        else:
            counts["kept"] += 1
            print(f"ok       {words}")
    rest = "".join(f", {counts[word]} {word}" for word in ("broken", "not checked") if counts[word])
    print(f"{counts['kept']} promises kept{rest}, in {time.perf_counter() - start:.1f} s")
    return set(counts) == {"kept"}


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread: inputs are so small that several threads would spend their time waiting."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _indented(text: str) -> str:
    return textwrap.fill(text, 100, initial_indent="  ", subsequent_indent="    ", break_long_words=False)
