"""What is known of plugin packages without importing them: presets, files of weights, attributes of classes."""

import importlib.machinery
import importlib.util
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

from anystyle import paths
from anystyle.registry.catalog import Plugin, PluginError, catalog, kinds, literals


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


def stated(plugin: Plugin, name: str) -> Any:
    """A class attribute, read from the class's own body if that states it as a literal, else by importing the class."""
    module, _, cls = plugin.target.partition(":")
    with suppress(OSError, SyntaxError, ValueError, ImportError):
        file = source_file(module, plugin.root) if plugin.defined is None else None
        found = {} if file is None else literals(file, cls)
        if name in found:
            return found[name]
    return getattr(plugin.load(), name)


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
