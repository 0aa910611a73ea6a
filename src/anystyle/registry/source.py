"""The catalog as a source of Hydra configurations, ``anystyle://``.

A configuration root says ``hydra: {searchpath: [anystyle://]}``. A kind is a group, a plugin an option of it. Groups
of which a configuration holds several at once are packaged by name: ``loss=[content,style]``, ``loss.style.weight=2``.
"""

from hydra.core.object_type import ObjectType
from hydra.core.plugins import Plugins
from hydra.errors import ConfigCompositionException
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource

from anystyle.registry.builtin import KINDS
from anystyle.registry.catalog import PluginError, catalog
from anystyle.registry.schema import node


class PluginSource(ConfigSource):
    """Configurations made of constructor signatures."""

    @staticmethod
    def scheme() -> str:
        """The scheme of this source."""
        return "anystyle"

    def available(self) -> bool:
        """Whether the source can be read; it always can."""
        return True

    def is_group(self, config_path: str) -> bool:
        """Whether a path is a kind, or the root of all."""
        return config_path.strip("/") in ("", *KINDS)

    def is_config(self, config_path: str) -> bool:
        """Whether a path is a plugin, ``kind/name``."""
        kind, _, name = config_path.removesuffix(".yaml").partition("/")
        return kind in KINDS and name in catalog().names(kind)

    def list(self, config_path: str, results_filter: ObjectType | None) -> "list[str]":
        """The kinds at the root, the plugins of a kind below it."""
        kind = config_path.strip("/")
        if not kind:
            return [] if results_filter is ObjectType.CONFIG else sorted(KINDS)
        return [] if results_filter is ObjectType.GROUP else catalog().names(kind)

    def load_config(self, config_path: str) -> ConfigResult:
        """Import one plugin and describe its options."""
        if not self.is_config(config_path):
            raise ConfigLoadError(f"Config not found: {config_path}")
        kind, _, name = config_path.removesuffix(".yaml").partition("/")
        try:
            config = node(catalog().find(kind, name))
        except PluginError as error:
            raise ConfigCompositionException(str(error)) from error
        package = f"{kind}.{name}" if KINDS[kind].many else None
        return ConfigResult(provider=self.provider, path=self.full_path(), config=config, header={"package": package})


def register() -> None:
    """Make ``anystyle://`` known to Hydra in this process; calling it again changes nothing."""
    Plugins.instance().register(PluginSource)
