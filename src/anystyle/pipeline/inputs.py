"""What is stylized: photographs, a saved scene, or views in memory. It is decided once, as a request is made."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from anystyle.data.folder import files_of
from anystyle.errors import UserError
from anystyle.paths import natural
from anystyle.registry.catalog import catalog
from anystyle.types import Views

OWN = ".safetensors"
"""The suffix of the Gaussians that ``anystyle stylize`` writes without any loss."""
CHECKPOINTS = (".pt", ".pth", ".ckpt")
PICTURE = "style.jpg"
"""The small picture of a style beside its result, where it is an image."""


@dataclass(frozen=True)
class Photographs:
    """Folders of photographs, files, patterns and videos."""

    paths: tuple[Path, ...]


@dataclass(frozen=True)
class SavedScene:
    """A file of Gaussians, or a folder of results."""

    path: Path


@dataclass(frozen=True)
class InMemory:
    """Views of one scene, in memory."""

    views: Views


Inputs = Photographs | SavedScene | InMemory
GivenInputs = str | Path | Sequence[str | Path] | Views
"""How Python names inputs: a folder, files, a pattern, a video or a saved scene; or views of one scene."""


def inputs_of(given: GivenInputs) -> Inputs | None:
    """What is given: one path may be a saved scene, others are photographs; ``None`` for no path."""
    if isinstance(given, Views):
        return InMemory(given)
    paths = tuple(map(Path, [given] if isinstance(given, (str, Path)) else given))
    if len(paths) == 1 and is_saved(paths[0]):
        return SavedScene(file_of(paths[0]))
    return Photographs(paths) if paths else None


def is_saved(path: Path) -> bool:
    """Whether this is a file or folder of Gaussians, or a folder that ``anystyle stylize`` wrote, and no capture."""
    if path.is_dir() and (path / "report.json").is_file() and any(path.glob("*.safetensors")):
        return True
    path = file_of(path)
    return scene_format(path) is not None or (path.suffix.lower() == OWN and not path.is_dir())


def file_of(path: Path) -> Path:
    """The file of a run's folder of 3DGS, ``point_cloud/iteration_N/point_cloud.ply`` of the largest N; else the path.

    Example:
        >>> file_of(Path("scene.ply"))
        PosixPath('scene.ply')

    Raises:
        UserError: It is a checkpoint of a trainer.
    """
    if path.suffix.lower() in CHECKPOINTS and path.is_file():
        raise UserError(
            f"{path} is a checkpoint, and files of Gaussians are read: gsplat's trainer writes a PLY with --save_ply, "
            "nerfstudio's scene becomes one by ns-export gaussian-splat"
        )
    found = path.glob("point_cloud/iteration_*/point_cloud.ply") if path.is_dir() else ()
    return max(found, key=lambda file: natural(file.parent.name), default=path)


def scene_format(path: Path) -> str | None:
    """The plugin of kind ``format`` that reads a file as a scene of Gaussians, by its suffix, if one does."""
    suffix = path.suffix.lower()[1:]
    return suffix if suffix in catalog().names("format") and not path.is_dir() else None


def check_inputs(inputs: Inputs | None) -> None:
    """Refuse inputs that are not there, which takes no time, before networks are loaded, which takes long."""
    match inputs:
        case SavedScene(path) if not path.exists():
            raise UserError(
                f"there is no file {path}; name photographs, a video, a file of Gaussians or a saved folder"
            )
        case Photographs(paths):
            for path in paths:
                files_of(path)
