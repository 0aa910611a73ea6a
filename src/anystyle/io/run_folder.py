"""A folder of results that belongs to one configuration, which its record holds."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from anystyle.errors import UserError
from anystyle.io.documents import read_json
from anystyle.paths import expanded

RECORD = "bound.json"
"""The file that holds the configuration."""


def refuse_changes(folder: Path, now: Mapping[str, Any], what: str, remedy: str, free: Sequence[str] = ()) -> bool:
    """Raise a UserError where a folder's record is of another configuration; returns whether there is a record.

    The configuration ``now`` is JSON values, nested or by full keys, of which ``free`` ones may change with all below
    them. The message says ``what`` the folder holds, such as ``an evaluation``, and the ``remedy``.
    """
    if not (folder / RECORD).is_file():
        return False
    before = read_json(folder / RECORD, dict[str, Any], what=f"record of {what}'s configuration; {remedy}")
    if changed := changes(without(flat(before), free), without(flat(now), free)):
        raise UserError(f"{folder} holds {what} of another configuration ({changed}); {remedy}")
    return True


def without(values: Mapping[str, Any], keys: Sequence[str]) -> dict[str, Any]:
    """Values by their full keys, less those of ``keys`` and below."""
    left_out = tuple(f"{key}." for key in keys)
    return {key: value for key, value in values.items() if not f"{key}.".startswith(left_out)}


def flat(node: Mapping[Any, Any], prefix: str = "") -> dict[str, Any]:
    """The values of a nested mapping by their full keys, such as ``backbone.depth``."""
    values: dict[str, Any] = {}
    for key, value in node.items():
        name = f"{prefix}{key}"
        values |= flat(value, f"{name}.") if isinstance(value, Mapping) else {name: value}
    return values


def _placed(value: object) -> object:
    """A value in which texts that name one file or folder are equal: absolute, relative, through a link."""
    if isinstance(value, list):
        return [_placed(part) for part in value]
    return os.path.realpath(expanded(value)) if isinstance(value, str) else value


def changes(before: Mapping[str, Any], now: Mapping[str, Any]) -> str:
    """The first five values that are not what they were, in words."""
    unequal = sorted(key for key in {*before, *now} if before.get(key) != now.get(key))
    changed = [key for key in unequal if _placed(before.get(key)) != _placed(now.get(key))]
    shown = [f"{key} {before.get(key)} -> {now.get(key)}" for key in changed[:5]]
    return ", ".join([*shown, *(["…"] if len(changed) > 5 else [])])
