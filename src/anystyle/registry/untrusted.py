"""Configurations saved in weights, checkpoints and runs: untrusted data, checked before anything is built from them."""

from collections.abc import Mapping
from typing import Any

from anystyle.errors import UserError
from anystyle.registry.catalog import catalog


def check_saved(config: Mapping[str, Any], source: object) -> None:
    """Refuse a saved configuration that names a class outside the catalog, or holds an interpolation.

    Args:
        config: Plain Python, as it was read.
        source: The file it was read from, for the message.
    """
    _check(config, "", {plugin.path for plugin in catalog()}, source)


def _check(node: Any, where: str, known: set[str], source: object) -> None:
    items = node.items() if isinstance(node, Mapping) else enumerate(node) if isinstance(node, (list, tuple)) else ()
    for key, value in items:
        name = f"{where}.{key}".lstrip(".")
        if key == "_target_" and value not in known:
            raise UserError(f"{source}: {name} is {value!r:.100}, which no plugin of the catalog is; it is not built")
        if isinstance(value, str) and "${" in value:
            raise UserError(f"{source}: {name} is {value!r:.100}; a saved configuration has no interpolations")
        _check(value, name, known, source)
