"""What is known of plugin packages without importing them: presets, files of weights, what a class is."""

import ast
import importlib.machinery
import importlib.util
import inspect
import typing
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from anystyle import paths
from anystyle.registry.catalog import Plugin, PluginError, catalog, kinds


def source_file(module: str, root: Path | None) -> Path | None:
    """The file of a module below ``root``, or where Python looks for it; unlike ``find_spec``, imports no package."""
    folders = None if root is None else [str(root)]
    spec = None
    for end in (index for index, letter in enumerate(f"{module}.") if letter == "."):
        find, name = importlib.machinery.PathFinder.find_spec, module[:end]
        spec = importlib.util.find_spec(name) if folders is None else find(name, folders)
        folders = [] if spec is None else list(spec.submodule_search_locations or ())
    origin = spec.origin if spec is not None and spec.origin is not None else ""
    return Path(origin) if origin.endswith(".py") else None


def first_line(plugin: Plugin) -> str:
    """The first line of the docstring of a plugin's class, read from its source, for importing it may take seconds."""
    text = plugin.defined and inspect.getdoc(plugin.defined)
    if text is None and (source := _source(plugin)[1]) is not None:
        text = ast.get_docstring(source)
    return text.partition("\n")[0] if text else f"(not described in {plugin.target})"


def constant(plugin: Plugin, name: str) -> Any:
    """An attribute of a plugin's class: as its source has it, where it is a literal there; else the class is imported.

    Raises:
        PluginError: The class has to be imported, and cannot be.
    """
    source = _source(plugin)[1] if plugin.defined is None else None
    for statement in source.body if source is not None else ():
        if isinstance(statement, ast.Assign) and ast.unparse(statement.targets[0]) == name:
            with suppress(ValueError):
                return ast.literal_eval(statement.value)
    return getattr(plugin.load(), name)


def arguments(plugin: Plugin) -> dict[str, str] | None:
    """What a plugin's constructor takes, with annotations, read from its source; ``None`` where that does not tell."""
    home, source = _source(plugin)
    if source is None or plugin.defined is not None:
        return None
    full = _Spelled(home, plugin.root).visit
    for each in source.body:
        if isinstance(each, ast.FunctionDef) and each.name == "__init__":
            own, given = ast.Name("Any"), [*each.args.args[1:], *each.args.kwonlyargs]
            return None if each.args.kwarg else {item.arg: ast.unparse(full(item.annotation or own)) for item in given}
    is_dataclass = any("dataclass" in ast.unparse(each) for each in source.decorator_list) and not source.bases
    fields = [each for each in source.body if isinstance(each, ast.AnnAssign)]
    return {ast.unparse(each.target): ast.unparse(full(each.annotation)) for each in fields} if is_dataclass else None


def _source(plugin: Plugin) -> tuple[str, ast.ClassDef | None]:
    """The module of a plugin's class and its source, where it is found."""
    module, _, name = plugin.target.partition(":")
    home, found = _defined(name, module, plugin.root)
    return home, found if isinstance(found, ast.ClassDef) else None


def _defined(name: str, module: str, root: Path | None) -> tuple[str, ast.AST | None]:
    """The statement that defines a name in a module, or in one that the module imports it from, and that module."""
    for statement in _body(module, root):
        if name in (getattr(statement, "name", ""), *map(ast.unparse, getattr(statement, "targets", ()))):
            return module, statement
        if isinstance(statement, ast.ImportFrom) and name in (alias.name for alias in statement.names):
            return _defined(name, statement.module, root) if statement.module else (module, None)
    return module, None


@cache
def _body(module: str, root: Path | None) -> list[ast.stmt]:
    with suppress(OSError, SyntaxError, ValueError, ImportError):
        file = source_file(module, root) or source_file(module, None)
        return ast.parse(file.read_bytes()).body if file else []
    return []


class _Spelled(ast.NodeTransformer):
    """Writes out the names of ``Literal`` types, a module's own or imported ones, in an annotation."""

    def __init__(self, module: str, root: Path | None) -> None:
        self.place = module, root

    def visit_Name(self, node: ast.Name) -> ast.AST:
        found = None if node.id in typing.__all__ else _defined(node.id, *self.place)[1]
        return found.value if isinstance(found, ast.Assign) and "= Literal[" in ast.unparse(found) else node


def packages() -> list[Path]:
    """The folder of each plugin's top-level module, for all plugins that are not built in; none is imported."""
    modules = {(row.target.partition(":")[0].partition(".")[0], row.root) for row in catalog() if row.defined is None}
    folders = {_folder(module, root) for module, root in modules}
    return sorted(folder for folder in folders if folder is not None and folder != paths.PACKAGE)


@cache
def _folder(module: str, root: Path | None) -> Path | None:
    try:
        file = source_file(module, root)
    except (ImportError, ValueError):
        return None
    return None if file is None else file.parent


def preset_folders() -> list[Path]:
    """The folders ``conf`` of plugin packages."""
    return [folder for package in packages() if (folder := package / "conf").is_dir()]


def package_presets(group: str) -> dict[str, Path]:
    """The configuration files that plugin packages add to a group, by name."""
    files: dict[str, Path] = {}
    for folder in preset_folders():
        for file in sorted((folder / group).glob("*.yaml")):
            other = files.setdefault(file.stem, file)
            if other != file:
                both = f"{paths.shown(other)} and {paths.shown(file)}"
                raise PluginError(f"{group}={file.stem} is declared more than once: {both}; rename one")
    return files


def presets(group: str) -> dict[str, Path]:
    """Every configuration file of a group by name: those of ``conf/`` and those of plugin packages."""
    local = {file.stem: file for file in sorted((paths.CONF / group).glob("*.yaml"))}
    return dict(sorted((package_presets(group) | local).items()))


def groups() -> list[str]:
    """Every configuration group: the kinds of plugins, then the folders of presets."""
    folders = {path.name for folder in (paths.CONF, *preset_folders()) for path in folder.glob("*/")}
    return [*kinds(), *sorted(folders - set(kinds()))]
