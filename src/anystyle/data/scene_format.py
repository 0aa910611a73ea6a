"""Which plugin of kind ``format`` reads a path as a scene of Gaussians, if one does."""

from pathlib import Path

from anystyle.io import video
from anystyle.registry.catalog import catalog
from anystyle.registry.packages import stated


def scene_format(path: Path) -> str | None:
    """The format of a file by its suffix, of a folder by the index in it; not of films, which are views."""
    names, suffix = catalog().names("format"), path.suffix.lower()
    if not path.is_dir():
        return suffix[1:] if suffix[1:] in names and suffix not in video.SUFFIXES else None
    indices = {name: stated(catalog().find("format", name), "index", "") for name in names}
    return next((name for name, index in indices.items() if index and (path / index).is_file()), None)
