"""The catalog and the presets of plugin packages as a source of Hydra configurations, ``anystyle://``.

A configuration root says ``hydra: {searchpath: [anystyle://]}``. A kind is a group, a plugin an option of it; so are
the files ``GROUP/NAME.yaml`` in a plugin package's ``conf``. Groups of which a configuration holds several at once are
packaged by name: ``loss=[content,style]``, ``loss.style.weight=2``.
"""

from pathlib import Path

from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.errors import ConfigCompositionException
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource

from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import PluginError, catalog
from anystyle.registry.guard import FileConfigSource, install
from anystyle.registry.packages import groups, package_presets
from anystyle.registry.schema import node


class PluginSource(ConfigSource):
    """Configurations made of constructor signatures, and the files beside them."""

    @staticmethod
    def scheme() -> str:
        """The scheme of this source."""
        return "anystyle"

    def available(self) -> bool:
        """Whether the source can be read; it always can."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Whether a path is a kind, a folder of presets, or the root of all."""
        return config_path.strip("/") in ("", *groups())

    def is_config(self, config_path: str) -> bool:
        """Whether a path is a plugin or a preset, ``group/name``."""
        group, _, name = config_path.removesuffix(".yaml").partition("/")
        return (group in KINDS and name in catalog().names(group)) or self._preset(group, name) is not None

    def list(self, config_path: str, results_filter: ObjectType | None) -> "list[str]":
        """The groups at the root, the plugins and presets of a group below it."""
        group = config_path.strip("/")
        if not group:
            return [] if results_filter is ObjectType.CONFIG else sorted(groups())
        if results_filter is ObjectType.GROUP:
            return []
        return sorted({*package_presets(group), *(catalog().names(group) if group in KINDS else ())})

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a preset, or import one plugin and describe its options."""
        if not self.is_config(config_path):
            raise ConfigLoadError(f"Config not found: {config_path}")
        group, _, name = config_path.removesuffix(".yaml").partition("/")
        preset = self._preset(group, name)
        if preset is not None:
            return FileConfigSource(self.provider, str(preset.parent)).load_config(preset.name)
        try:
            config = node(catalog().find(group, name))
        except PluginError as error:
            raise ConfigCompositionException(str(error)) from error
        package = f"{group}.{name}" if KINDS[group].many else None
        return ConfigResult(self.provider, self.full_path(), config, {"package": package})

    @staticmethod
    def _preset(group: str, name: str) -> Path | None:
        try:
            return package_presets(group).get(name)
        except PluginError as error:
            raise ConfigCompositionException(str(error)) from error


def register() -> None:
    """Make ``anystyle://`` known to Hydra in this process; calling it again changes nothing."""
    Plugins.instance().register(PluginSource)
    install()
