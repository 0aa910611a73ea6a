"""Where two configurations differ."""

from collections.abc import Mapping
from typing import Any


def flat(node: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a nested mapping by their full keys, such as ``backbone.depth``."""
    values: dict[str, Any] = {}
    for key, value in node.items():
        name = f"{prefix}{key}"
        values |= flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return values


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first five values that are not what they were, in words; empty where all are."""
    changed = sorted(key for key in {*before, *now} if before.get(key) != now.get(key))
    shown = [f"{key} {before.get(key)} -> {now.get(key)}" for key in changed[:5]]
    return ", ".join([*shown, *(["…"] if len(changed) > 5 else [])])
