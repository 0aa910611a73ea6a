"""What the scores of an evaluation rest on besides weights: plugins, and the files that its configuration names."""

import hashlib
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from anystyle.io.checkpoint import sha256
from anystyle.io.run_folder import RECORD, flat
from anystyle.paths import expanded
from anystyle.registry.catalog import catalog

INPUTS = ("protocol", "scenes", "styles", "method", "correspondence")
"""Parts of a configuration whose files and folders are inputs."""
MOST_BYTES = 4 * 2**30
"""Larger folders are known by the names and sizes of their files alone."""


def foundations(config: Mapping[str, Any]) -> dict[str, Any]:
    """What the scores of a resolved configuration rest on besides weights, for their record.

    ``plugins`` are versions by distribution, ``inputs`` hashes by the option that names the file or folder, and
    ``folder`` is where relative paths begin.
    """
    values = flat({name: config[name] for name in INPUTS if isinstance(config.get(name), Mapping)})
    named = {key: Path(expanded(value)) for key, value in values.items() if isinstance(value, str) and value}
    inputs = {key: digest(path) for key, path in named.items() if path.exists()}
    targets = {value for key, value in flat(config).items() if key.endswith("_target_")}
    projects = {plugin.project for plugin in catalog() if plugin.path in targets} - {None}
    plugins = {name: _version(name) for name in sorted(map(str, projects))}
    return {"folder": str(Path.cwd()), "inputs": inputs, "plugins": plugins}


def digest(path: Path) -> str:
    """The SHA-256 of a file, or of the listing of a folder's files; ``sizes`` where only their sizes were read.

    Evaluations and trainings that lie in the folder are left out.
    """
    if path.is_file():
        return sha256(path)
    results = {record.parent for record in path.rglob(RECORD)} - {path}
    files = sorted(
        file
        for file in path.rglob("*")
        if file.is_file() and not file.name.startswith(".") and results.isdisjoint(file.parents)
    )
    whole = sum(file.stat().st_size for file in files) <= MOST_BYTES
    lines = (
        f"{sha256(file) if whole else file.stat().st_size}  {file.relative_to(path).as_posix()}\n" for file in files
    )
    listed = hashlib.sha256("".join(lines).encode(errors="surrogateescape")).hexdigest()
    return listed if whole else f"sizes {listed}"


def _version(project: str) -> str:
    try:
        return version(project)
    except PackageNotFoundError:
        return "of a folder"  # which is not installed: the commit of the checkout tells
