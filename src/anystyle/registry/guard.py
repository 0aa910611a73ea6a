"""What a composed configuration may build, wherever it came from: plugins of the catalog, and of Hydra a short list.

Hydra builds its callbacks, its launcher, its sweeper and the logging from configuration nodes, before a command sees
any of it. What it composes is therefore judged here, between composing and everything else.
"""

import copy
import functools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.errors import ConfigCompositionException
from hydra.plugins.config_source import ConfigLoadError, ConfigResult, ConfigSource
from omegaconf import DictConfig, OmegaConf

from anystyle.caching import LRUCache
from anystyle.documents import read_text, read_yaml
from anystyle.errors import UserError, one_line
from anystyle.registry.catalog import catalog

_LAUNCH = ("hydra._internal.core_plugins.basic_", "hydra_plugins.")
"""Where launchers and sweepers come from: Hydra itself, and packages installed as plugins of it."""
_CALLBACKS = frozenset({"hydra.experimental.callbacks.LogJobReturnCallback"})
_LOGGING = frozenset(
    {
        "logging.StreamHandler", "logging.FileHandler", "logging.NullHandler", "logging.Formatter",
        "colorlog.ColoredFormatter", "ext://sys.stdout", "ext://sys.stderr",
    }
)  # fmt: skip
_BUILDS = ("_target_", "()", "class", "factory", "..factory")
"""Keys under which Hydra, or Python's logging, is told what to call."""
_VARIABLES = ("PYTHON", "LD_", "DYLD_", "ANYSTYLE_PLUGINS", "PATH")
"""Environment variables that decide what code a process runs begin so."""


def check(config: DictConfig) -> None:
    """Refuse a composed configuration that builds what it must not.

    Raises:
        UserError: One line names the node and what is allowed.
    """
    plain: Any = OmegaConf.to_container(config, resolve=False, enum_to_str=True)
    hydra = plain.pop("hydra", {}) if isinstance(plain, dict) else {}
    known = {plugin.path for plugin in catalog()}
    for where, key, value in _builds(plain, ""):
        if key == "_target_" and value not in known:
            raise UserError(f"{where} is {_shown(value)}, which is no plugin of the catalog; nothing else is built")
    for name, node in hydra.items():
        if name not in ("callbacks", "launcher", "sweeper", "job_logging", "hydra_logging"):
            continue
        if isinstance(node, str):
            raise UserError(f"hydra.{name} is {_shown(node)}; it must say itself what it is")
        for where, key, value in _builds(node, f"hydra.{name}"):
            if not _allowed(name, key, value):
                raise UserError(f"{where} is {_shown(value)}, which a configuration may not build")
    for variable in (hydra.get("job") or {}).get("env_set") or {}:
        if str(variable).upper().startswith(_VARIABLES):
            raise UserError(f"hydra.job.env_set.{variable} decides what code runs; set it in the environment itself")


def _allowed(name: str, key: str, value: object) -> bool:
    if name in ("launcher", "sweeper"):
        return key != "_target_" or (isinstance(value, str) and value.startswith(_LAUNCH))
    if name == "callbacks":
        return key != "_target_" or value in _CALLBACKS
    return value in _LOGGING


def _builds(node: Any, where: str) -> Iterator[tuple[str, str, Any]]:
    """Every place of a configuration that may say what is called: its name, the key, the value.

    A text that resolves to a whole node counts, and so does an object that Python's logging looks up.
    """
    items = node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ()
    for key, value in items:
        name = f"{where}.{key}".lstrip(".")
        if key in _BUILDS or (isinstance(value, str) and value.startswith(("ext://", "cfg://"))):
            yield name, str(key), value
        elif where.startswith("hydra.") and isinstance(value, str) and _makes_nodes(value):
            yield name, "_target_", value
        yield from _builds(value, name)


def _makes_nodes(text: str) -> bool:
    return "${oc.create" in text or "${oc.decode" in text


def _shown(value: object) -> str:
    return repr(value)[:100]


class FileConfigSource(file_config_source.FileConfigSource):
    """Configuration files, read through the door for documents.

    Named as Hydra's: in the process of a launcher's job Hydra registers its sources after this one has arrived there,
    and leaves one of the same name in its place.
    """

    def load_config(self, config_path: str) -> ConfigResult:
        """Read a file of this source.

        Raises:
            ConfigLoadError: There is none.
            ConfigCompositionException: It is no configuration; one line names it.
        """
        path = Path(self.path, self._normalize_file_name(config_path))
        if not path.is_file():
            raise ConfigLoadError(f"Config not found : {path}")
        state = path.stat()
        header, config = _KEPT.get((path, state.st_ino, state.st_mtime_ns, state.st_size), lambda: _read(path))
        # Hydra takes the defaults list out of what it is given.
        config = copy.deepcopy(config)
        return ConfigResult(config=config, path=f"file://{self.path}", provider=self.provider, header=dict(header))


_KEPT: LRUCache[tuple[Path, int, int, int], tuple[dict[str, str | None], DictConfig]] = LRUCache(512)
"""Files as they were read: a sweep composes them several times for each of its jobs, and YAML is slow."""


def _read(path: Path) -> tuple[dict[str, str | None], DictConfig]:
    """The header and the content of a configuration file."""
    try:
        header = ConfigSource._get_header_dict(read_text(path)[:512])
        content = read_yaml(path, dict[str, Any] | None, what="configuration of 'key: value' lines", limit=False)
        return header, OmegaConf.create(content or {})
    except UserError as error:
        raise ConfigCompositionException(str(error)) from None
    except Exception as error:
        # Interpolations that end nowhere, keys that are none.
        raise ConfigCompositionException(f"{path} is no configuration ({one_line(error)[:300]})") from None


def install() -> None:
    """Let Hydra in this process read files through the door; again changes nothing."""
    SourcesRegistry.instance().types["file"] = FileConfigSource


_load = ConfigLoaderImpl.load_configuration


@functools.wraps(_load)
def _load_judged(self: ConfigLoaderImpl, *args: Any, **options: Any) -> DictConfig:
    config = _load(self, *args, **options)
    check(config)
    return config


# When this file is imported: the process of a launcher's job imports it with the source above, and installs nothing.
ConfigLoaderImpl.load_configuration = _load_judged
