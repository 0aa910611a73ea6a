"""Configurations saved in weights, checkpoints and runs: untrusted data, checked before anything is built from them."""

from collections.abc import Mapping
from typing import Any

from anystyle.errors import UserError
from anystyle.registry.catalog import catalog


def check_saved(config: Mapping[str, Any], source: object) -> dict[str, Any]:
    """A saved configuration, read from ``source``, as a plain dictionary.

    Raises:
        UserError: The configuration names a class outside the catalog, or holds an interpolation.
    """
    known = {plugin.path for plugin in catalog()}

    def checked(node: Any, where: str) -> Any:
        if isinstance(node, Mapping):
            return {key: checked(value, f"{where}.{key}".lstrip(".")) for key, value in node.items()}
        if isinstance(node, (list, tuple)):
            return [checked(value, f"{where}.{index}") for index, value in enumerate(node)]
        said = f"{source}: {where} is {node!r:.100}"
        if where.rpartition(".")[2] == "_target_" and node not in known:
            raise UserError(f"{said}, which is not a registered plugin; it is not built")
        if isinstance(node, str) and "${" in node:
            raise UserError(f"{said}; a saved configuration has no interpolations")
        return node

    return checked(config, "")
