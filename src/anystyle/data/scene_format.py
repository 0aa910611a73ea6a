"""Which plugin of kind ``format`` reads a path as a scene of Gaussians, if one does."""

from pathlib import Path

from anystyle.registry.catalog import catalog


def scene_format(path: Path) -> str | None:
    """The format of a file, by its suffix."""
    suffix = path.suffix.lower()[1:]
    return suffix if suffix in catalog().names("format") and not path.is_dir() else None
