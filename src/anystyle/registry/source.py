"""The catalog and the presets of plugin packages as a source of Hydra configurations, ``anystyle://``.

A configuration root says ``hydra: {searchpath: [anystyle://]}``. A kind is a group, a plugin an option of it; so are
the files ``GROUP/NAME.yaml`` in a plugin package's ``conf``. Groups of which a configuration holds several at once are
packaged by name: ``loss=[content,style]``, ``loss.style.weight=2``.
"""

import pkgutil
import re
from functools import cached_property
from pathlib import Path
from typing import Any

from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.errors import ConfigCompositionException
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf

from anystyle.errors import UserError
from anystyle.io.documents import read_text, read_yaml
from anystyle.registry.builtin import OPTIONS
from anystyle.registry.catalog import PluginError, base_of, catalog, kinds
from anystyle.registry.packages import groups, package_presets
from anystyle.registry.schema import node

_OPTIONS = "options"


class PluginSource(ConfigSource):
    """Configurations made of constructor signatures, of dataclasses of options, and of the files beside plugins.

    Hydra makes one for each command, and asks it again and again: what there is stays as it was at first. It is pickled
    for the processes of a launcher.
    """

    def __init__(self, provider: str, path: str) -> None:
        super().__init__(provider, path)
        self._known: dict[str, dict[str, Path]] = {}

    @cached_property
    def _groups(self) -> "list[str]":
        return groups()

    def _presets(self, group: str) -> dict[str, Path]:
        if group not in self._known:
            try:
                self._known[group] = package_presets(group)
            except PluginError as error:
                raise ConfigCompositionException(str(error)) from error
        return self._known[group]

    @staticmethod
    def scheme() -> str:
        return "anystyle"

    def available(self) -> bool:
        return True

    def is_group(self, config_path: str) -> bool:
        return config_path.strip("/") in ("", _OPTIONS, *self._groups)

    def is_config(self, config_path: str) -> bool:
        group, name = _split(config_path)
        return name in self._names(group)

    def list(self, config_path: str, results_filter: ObjectType | None) -> "list[str]":
        group = config_path.strip("/")
        if not group:
            return [] if results_filter is ObjectType.CONFIG else sorted(self._groups)
        return [] if results_filter is ObjectType.GROUP else self._names(group)

    def load_config(self, config_path: str) -> ConfigResult:
        group, name = _split(config_path)
        if name not in self._names(group):
            raise ConfigLoadError(f"Config not found: {config_path}")
        preset = self._presets(group).get(name)
        if preset is not None:
            return ConfigResult(self.provider, self.full_path(), *_read(preset))
        if group == _OPTIONS:
            config = OmegaConf.structured(pkgutil.resolve_name(OPTIONS[name]))
            OmegaConf.set_readonly(config, None)  # a frozen dataclass makes it so
            for value in config.values():
                if isinstance(value, DictConfig):
                    OmegaConf.set_struct(value, False)  # a mapping takes any key
            return ConfigResult(self.provider, self.full_path(), config, {"package": name})
        try:
            config = node(catalog().find(group, name))
        except PluginError as error:
            raise ConfigCompositionException(str(error)) from error
        package = f"{group}.{name}" if base_of(group).many else None
        return ConfigResult(self.provider, self.full_path(), config, {"package": package})

    def _names(self, group: str) -> "list[str]":
        if group == _OPTIONS:
            return sorted(OPTIONS)
        return sorted({*self._presets(group), *(catalog().names(group) if group in kinds() else ())})


def _split(config_path: str) -> tuple[str, str]:
    group, _, name = config_path.removesuffix(".yaml").partition("/")
    return group, name


_HEADER = re.compile(r"^# *@(\w+) *:? *(\S+) *$", re.MULTILINE)


def _read(path: Path) -> tuple[DictConfig, dict[str, str | None]]:
    """The content of a preset, and its header, such as ``# @package _global_``."""
    try:
        content = read_yaml(path, dict[str, Any] | None, what="configuration of 'key: value' lines", limit=False)
        return OmegaConf.create(content or {}), {"package": None, **dict(_HEADER.findall(read_text(path)))}
    except UserError as error:
        raise ConfigCompositionException(str(error)) from None


def register() -> None:
    """Make ``anystyle://`` known to Hydra in this process; calling it again changes nothing."""
    Plugins.instance().register(PluginSource)
