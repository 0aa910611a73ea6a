"""Configurations saved in weights, checkpoints and runs: untrusted data, checked before anything is built from them."""

import warnings
from collections.abc import Mapping
from typing import Any

from anystyle.deprecated import present
from anystyle.errors import UserError
from anystyle.registry.catalog import catalog


def check_saved(config: Mapping[str, Any], source: object) -> dict[str, Any]:
    """A saved configuration with the present paths of classes that have moved.

    Args:
        config: Plain Python, as it was read.
        source: The file it was read from, for messages.

    Raises:
        UserError: The configuration names a class outside the catalog, or holds an interpolation.
    """
    known = {plugin.path for plugin in catalog()}

    def checked(node: Any, where: str) -> Any:
        if isinstance(node, Mapping):
            return {key: checked(value, f"{where}.{key}".lstrip(".")) for key, value in node.items()}
        if isinstance(node, (list, tuple)):
            return [checked(value, f"{where}.{index}") for index, value in enumerate(node)]
        if where.rpartition(".")[2] == "_target_" and node not in known:
            moved = _moved(str(node), source)
            if moved not in known:
                raise UserError(
                    f"{source}: {where} is {node!r:.100}, which is not a registered plugin; it is not built"
                )
            return moved
        if isinstance(node, str) and "${" in node:
            raise UserError(f"{source}: {where} is {node!r:.100}; a saved configuration has no interpolations")
        return node

    return checked(config, "")


def _moved(path: str, source: object) -> str:
    if (now := present(path)) != path:
        warnings.warn(f"{source}: {path} is {now} now", DeprecationWarning, stacklevel=4)
    return now
