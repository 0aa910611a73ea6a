"""The static catalog: every plugin by name, none imported until it is chosen.

Plugins are declared in three places: the table in :mod:`anystyle.registry.builtin`; entry points
``anystyle.<kind>`` of installed packages; the same lines in the ``pyproject.toml`` of folders that are not
installed, under ``plugins/`` or in a folder that ``ANYSTYLE_PLUGINS`` lists. A running process adds its own
with :func:`plugin`. A package declares a kind of its own with an entry point ``anystyle.kind``, whose value is the
contract.
"""

import importlib
import logging
import os
import pkgutil
import sys
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from operator import attrgetter
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import msgspec

from anystyle import paths
from anystyle.errors import Terminated, UserError, one_line, unknown
from anystyle.io.documents import read_toml
from anystyle.paths import expanded
from anystyle.registry.builtin import BUILTIN, KINDS

VARIABLE = "ANYSTYLE_PLUGINS"
_PREFIX = "anystyle."
_KIND = "kind"
_log = logging.getLogger(__name__)
_Class = TypeVar("_Class", bound=type)


class Pluggable:
    """The base of contracts: what the plugins of a kind inherit from."""

    many: ClassVar[bool] = False
    """Whether a configuration holds several plugins of the kind at once."""
    runtime: ClassVar[tuple[str, ...]] = ()
    """Constructor arguments that are passed by name, and that are not options."""

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Options of an instance that can be checked in seconds; the constructor's defaults, unless overridden.

        A large network returns a few thin layers, a data set the path of a small sample of its format that it has
        just written.

        Args:
            folder: An empty folder to write into, there for as long as the instance is used.
        """
        return {}


class PluginError(UserError):
    """A plugin that does not exist, cannot be imported or breaks its contract."""


def kinds() -> list[str]:
    """The names of all kinds: those of the core, then those that packages declare."""
    return [*KINDS, *catalog().names(_KIND)]


@dataclass(frozen=True)
class Plugin:
    """One declaration.

    Args:
        kind: One of :func:`kinds`.
        name: How configurations call it.
        target: ``module:Class``.
        origin: What declares it, to display.
        root: The folder its module is imported from, where it is not installed.
        project: The distribution it belongs to, where it belongs to one.
        defined: The class itself, where a running process declared it.
    """

    kind: str
    name: str
    target: str
    origin: str
    root: Path | None = None
    project: str | None = None
    defined: type | None = field(default=None, repr=False)

    @property
    def path(self) -> str:
        """The class as configurations write it, ``module.Class``."""
        return self.target.replace(":", ".")

    def __str__(self) -> str:
        return f"{self.kind} '{self.name}' ({self.target}, declared by {self.origin})"

    def load(self) -> type:
        """Import the class."""
        base = base_of(self.kind)  # first: where its package is not installed, this makes it importable
        loaded = self.defined if self.defined is not None else _import(self)
        if not (isinstance(loaded, type) and issubclass(loaded, base)):
            home = base.__module__.rpartition(".")[0] if self.kind in KINDS else base.__module__
            raise PluginError(f"{self} must inherit from {home}.{base.__qualname__}")
        return loaded


def location_in(error: BaseException, module: str) -> str:
    """`` (FILE, line N)``: where in the top-level package of a module an error came from; empty if it did not."""
    package = module.partition(".")[0]
    frames = [
        f" ({Path(frame.f_code.co_filename).name}, line {line})"
        for frame, line in traceback.walk_tb(error.__traceback__)
        if str(frame.f_globals.get("__name__")).partition(".")[0] == package
    ]
    return frames[-1] if frames else ""


def base_of(kind: str) -> type[Pluggable]:
    """Import the contract of a kind; a PluginError where there is none, or its package cannot be imported."""
    if kind in KINDS:
        return pkgutil.resolve_name(KINDS[kind])
    if not (declared := catalog().declarations(_KIND, kind)):
        raise PluginError(unknown("kind of plugin", kind, kinds()))
    contract = _import(declared[0])
    if not (isinstance(contract, type) and issubclass(contract, Pluggable)):
        raise PluginError(f"{declared[0]} must inherit from {Pluggable.__module__}.{Pluggable.__qualname__}")
    return contract


def _import(plugin: Plugin) -> Any:
    module_name, _, qualified = plugin.target.partition(":")
    if plugin.root is not None and str(plugin.root) not in sys.path:
        # Last, so that a plugin's folder hides nothing; worker processes that are spawned inherit it.
        sys.path.append(str(plugin.root))
        importlib.invalidate_caches()
    try:
        module = importlib.import_module(module_name)
        value = attrgetter(qualified)(module)
    except Terminated:
        raise
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {one_line(error)}".rstrip(": ")
        raise PluginError(f"{plugin} cannot be imported: {reason}{location_in(error, module_name)}") from error
    if plugin.root is not None:
        files = [Path(file).resolve() for file in (module.__file__, *getattr(module, "__path__", ())) if file]
        if not any(file.is_relative_to(plugin.root) for file in files):
            other = f"another module is called '{module_name}' ({files[0]})"
            raise PluginError(f"{plugin} cannot be imported: {other}; rename one of them, or uninstall the other")
    return value


class Catalog:
    """Every declared plugin, and what could not be read, one line each, which the error for an unknown name shows."""

    def __init__(self, plugins: Iterable[Plugin], problems: Sequence[str] = ()) -> None:
        self._plugins = tuple(plugins)
        self.problems = tuple(problems)

    def __iter__(self) -> Iterator[Plugin]:
        return iter(self._plugins)

    def names(self, kind: str) -> list[str]:
        """The names of one kind, sorted; a PluginError where there is no such kind."""
        self._check(kind)
        return sorted({plugin.name for plugin in self._plugins if plugin.kind == kind})

    def declarations(self, kind: str, name: str) -> list[Plugin]:
        """All declarations of a name; a good one has exactly one."""
        return [plugin for plugin in self._plugins if (plugin.kind, plugin.name) == (kind, name)]

    def find(self, kind: str, name: str) -> Plugin:
        """The plugin of that name.

        Raises:
            PluginError: No plugin, or more than one, is declared under it.

        Example:
            >>> catalog().find("injector", "film").path
            'anystyle.injectors.film.FiLM'
        """
        self._check(kind)
        plugins = self.declarations(kind, name)
        if len(plugins) > 1:
            raise PluginError(f"{kind} '{name}' is declared more than once: {'; '.join(map(str, plugins))}; rename one")
        if not plugins:
            ignored = f" (ignored: {'; '.join(self.problems)})" if self.problems else ""
            raise PluginError(unknown(kind, name, self.names(kind)) + ignored)
        return plugins[0]

    def _check(self, kind: str) -> None:
        known = {*KINDS, *(plugin.name for plugin in self._plugins if plugin.kind == _KIND)}
        if kind not in (*known, _KIND):
            raise PluginError(unknown("kind of plugin", kind, known))

    def owner(self, kind: str, path: str) -> Plugin:
        """The plugin whose class a configuration's ``_target_`` names."""
        named = {plugin.kind: plugin.name for plugin in self._plugins if plugin.path == path}
        if kind in named:
            return self.find(kind, named[kind])
        wrong = "not a plugin; a config may build only what `anystyle plugins` lists"
        for other in named:
            wrong = f"a {other}, and a {kind} is expected here"
        raise PluginError(f"_target_ '{path}' is {wrong}")

    def name_of(self, kind: str, cls: type) -> str:
        """The name that a class is registered by; its path where the catalog does not list it."""
        for plugin in self._plugins:
            module, _, qualified = plugin.target.partition(":")  # which may have it from another module
            with suppress(AttributeError):
                if plugin.kind == kind and attrgetter(qualified)(sys.modules.get(module)) is cls:
                    return plugin.name
        return f"{cls.__module__}.{cls.__qualname__}"


def _rows(point: EntryPoint, problems: list[str], origin: str, **options: Any) -> Iterator[Plugin]:
    """The plugin that an entry point declares, or a note on what is wrong with it."""
    kind, target = point.group.removeprefix(_PREFIX), point.value.partition("[")[0].strip()
    if not point.name.isidentifier():
        problems.append(f"{origin} names a {kind} '{point.name}'; a name is made of letters, digits and '_'")
    elif not all(word.isidentifier() for word in target.replace(":", ".", 1).split(".")) or ":" not in target:
        problems.append(f"{origin} declares {kind} '{point.name}' as '{point.value}', which is not 'module:Class'")
    else:
        yield Plugin(kind, point.name, target, origin, **options)


def _installed(problems: list[str]) -> Iterator[Plugin]:
    points = entry_points()
    groups = sorted(group for group in points.groups if group.startswith(_PREFIX))
    for point in (point for group in groups for point in points.select(group=group)):
        name = point.dist.name if point.dist else None
        origin = f"{name} {point.dist.version}" if point.dist else "an installed package"
        yield from _rows(point, problems, origin, project=name)


class _Project(msgspec.Struct, rename="kebab"):
    name: str | None = None
    entry_points: dict[str, dict[str, Any]] = msgspec.field(default_factory=dict)


class _PyProject(msgspec.Struct):
    project: _Project = msgspec.field(default_factory=_Project)


def _local(root: Path, problems: list[str]) -> Iterator[Plugin]:
    origin = paths.shown(root)
    try:
        declared: _PyProject = read_toml(root / "pyproject.toml", _PyProject, what="project")
    except UserError as error:
        problems.append(f"{origin}/pyproject.toml cannot be read: {error}")
        return
    for group, rows in declared.project.entry_points.items():
        for key, value in rows.items() if group.startswith(_PREFIX) else ():
            point = EntryPoint(key, str(value), group)
            yield from _rows(point, problems, origin, root=root, project=declared.project.name)


def _roots(folders: Sequence[str], problems: list[str]) -> list[Path]:
    """The plugin folders: each listed one, or else the folders in it, that hold a ``pyproject.toml``."""
    roots: dict[Path, None] = {}
    problems += [f"{VARIABLE} lists {folder}, which is not a folder" for folder in folders if not Path(folder).is_dir()]
    for folder in filter(Path.is_dir, (paths.PLUGINS, *map(Path, folders))):
        candidates = [folder] if (folder / "pyproject.toml").is_file() else sorted(folder.iterdir())
        roots |= {root.resolve(): None for root in candidates if (root / "pyproject.toml").is_file()}
    return list(roots)


@cache
def _static(folders: tuple[str, ...]) -> Catalog:
    problems: list[str] = []
    local = [plugin for root in _roots(folders, problems) for plugin in _local(root, problems)]

    def identity(plugin: Plugin) -> tuple[str, str, str, str]:
        project = (plugin.project or "").lower().replace("-", "_").replace(".", "_")
        return plugin.kind, plugin.name, plugin.target, project

    # A folder that is installed too, in place as a rule, is one plugin, not two of one name.
    seen = set(map(identity, local))
    declared = [*(plugin for plugin in _installed(problems) if identity(plugin) not in seen), *local]
    known = {*KINDS, _KIND, *(plugin.name for plugin in declared if plugin.kind == _KIND)}
    strange = [plugin for plugin in declared if plugin.kind not in known]
    problems += [f"{row.origin} declares '{_PREFIX}{row.kind}', and there is no such kind of plugin" for row in strange]
    for problem in problems:
        _log.warning("ignored: %s", problem)
    builtin = (Plugin(kind, *row, "anystyle", project="anystyle") for kind in BUILTIN for row in BUILTIN[kind].items())
    return Catalog([*builtin, *(plugin for plugin in declared if plugin not in strange)], problems)


_OWN: dict[tuple[str, str], Plugin] = {}


def catalog() -> Catalog:
    """The catalog of this process.

    Relative folders in ``ANYSTYLE_PLUGINS`` are made absolute there, so that the processes this one starts find them
    from wherever they run.
    """
    listed = [folder for folder in os.environ.get(VARIABLE, "").split(os.pathsep) if folder]
    folders = tuple(str(expanded(folder).absolute()) for folder in listed)
    if folders:
        os.environ[VARIABLE] = os.pathsep.join(folders)
    static = _static(folders)
    return Catalog([*static, *_OWN.values()], static.problems) if _OWN else static


def plugin(kind: str, name: str) -> Callable[[_Class], _Class]:
    """Add a class to the catalog of the running process, by the name that configurations call it; for notebooks.

    Declaring a class of the same name again, as running a cell twice does, replaces it.

    Raises:
        PluginError: The kind is unknown, the name is taken or not an identifier, or the class breaks the contract.
    """

    def add(declared: _Class) -> _Class:
        target = f"{declared.__module__}:{declared.__qualname__}"
        row = Plugin(kind, name, target, "this process", defined=declared)
        base_of(kind)
        if not name.isidentifier():
            raise PluginError(f"{row} needs another name: one made of letters, digits and '_'")
        for other in catalog().declarations(kind, name):
            if other.defined is None or other.target != target:
                raise PluginError(f"{kind} '{name}' is declared already: {other}; choose another name")
        row.load()
        _OWN[kind, name] = row
        return declared

    return add
