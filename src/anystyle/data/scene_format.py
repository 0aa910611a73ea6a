"""Which plugin of kind ``format`` reads a path as a scene of Gaussians, if one does."""

from pathlib import Path

from anystyle.io import video
from anystyle.registry.catalog import catalog


def scene_format(path: Path) -> str | None:
    """The format of a file by its suffix; not of films, which are views."""
    suffix = path.suffix.lower()
    known = suffix[1:] in catalog().names("format") and suffix not in video.SUFFIXES
    return suffix[1:] if known and not path.is_dir() else None
