"""What every plugin promises before it is built: that a configuration can name it and check its options."""

import tempfile
from dataclasses import dataclass
from functools import cached_property
from inspect import getdoc
from pathlib import Path
from typing import Any

from anystyle.registry.catalog import Plugin, PluginError, base_of, catalog
from anystyle.registry.schema import node, plain
from anystyle.registry.socket import Socket
from anystyle.testing.check import Check, ContractError, attempt, expect


@dataclass(frozen=True)
class Declaration:
    """A plugin by its name.

    Args:
        kind: A kind of plugin.
        name: A name that the catalog lists.
        folder: An empty folder for what its example needs.
    """

    kind: str
    name: str
    folder: Path

    @cached_property
    def plugin(self) -> Plugin:
        """Its row of the catalog."""
        return catalog().find(self.kind, self.name)

    @cached_property
    def options(self) -> dict[str, Any]:
        """Those it is checked with."""
        return example(self.plugin.load(), self.folder)


def example(cls: type[Socket], folder: Path) -> dict[str, Any]:
    """The options that a class is checked with, as :meth:`anystyle.registry.socket.Socket.example` says."""
    given = cls.example(Path(tempfile.mkdtemp(dir=folder)))
    expect(
        isinstance(given, dict),
        given=f"`example` returned {given!r}",
        expected="a dictionary of options",
        change="return {} for the defaults",
    )
    return dict(given)


def name_is_declared_once(declared: Declaration) -> None:
    """No two plugins of a kind have one name."""
    rows = catalog().declarations(declared.kind, declared.name)
    expect(
        len(rows) == 1,
        given=f"{len(rows)} declarations: {'; '.join(map(str, rows))}",
        change="rename one of them in its pyproject.toml, or uninstall it",
    )


def class_can_be_imported(declared: Declaration) -> None:
    """Its module can be imported, and has the class, which inherits from the contract of its kind."""
    try:
        declared.plugin.load()
    except PluginError as error:
        base = base_of(declared.kind)
        raise ContractError(
            given=str(error),
            expected=f"a class that can be imported and inherits from {base.__module__}.{base.__qualname__}",
            change="mend the import, the name behind the ':' or the base class",
        ) from error


def every_method_is_there(declared: Declaration) -> None:
    """The class implements all that its contract leaves open."""
    missing = sorted(getattr(declared.plugin.load(), "__abstractmethods__", ()))
    expect(
        not missing,
        given=f"{declared.plugin.load().__name__} lacks {', '.join(missing)}",
        change="implement them; their docstrings in the contract say what they do",
    )


def options_can_be_checked(declared: Declaration) -> None:
    """The constructor names, annotates and defaults every option, so that a configuration is checked against it."""
    try:
        node(declared.plugin)
    except PluginError as error:
        raise ContractError(
            given=str(error),
            expected="options by name, annotated with int, float, bool, str, a sequence, a Literal or an optional one",
            change="write the constructor as `def __init__(self, *, option: type = default)`, without **kwargs",
        ) from error


def first_line_describes_it(declared: Declaration) -> None:
    """The class has a docstring, whose first line `anystyle plugins` shows."""
    cls = declared.plugin.load()
    text = cls.__doc__ or ""
    inherited = text == (base_of(declared.kind).__doc__ or "")
    expect(
        bool(text.strip()) and not inherited and bool(getdoc(cls)),
        given=f"{cls.__name__} without a docstring",
        expected="one line that says what it is",
        change="write it under `class`, and the options under `Args:`",
    )


def example_fits_the_options(declared: Declaration) -> None:
    """What ``example`` returns are options of the constructor, of the right types."""
    with attempt(
        "`example`", change="return a dictionary of options; write what they name into the folder it is given"
    ):
        options = declared.options
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        OmegaConf.merge(node(declared.plugin), plain(options))
    except OmegaConfBaseException as error:
        raise ContractError(
            given=f"`example` returned {options!r}: {str(error).splitlines()[0]}",
            change="correct the name or the type of that option",
        ) from error


CHECKS: tuple[Check, ...] = (
    Check(name_is_declared_once, needed=True),
    Check(class_can_be_imported, needed=True),
    Check(every_method_is_there, needed=True),
    Check(options_can_be_checked, needed=True),
    Check(first_line_describes_it),
    Check(example_fits_the_options, needed=True),
)
