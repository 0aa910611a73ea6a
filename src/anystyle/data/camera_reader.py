"""Cameras that programs store for photographs: a kind of plugin."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from anystyle.registry.build import build
from anystyle.registry.catalog import catalog
from anystyle.registry.socket import Socket


class Undistortion(NamedTuple):
    """What removes the distortion of a lens."""

    apply: Callable[[Image.Image], Image.Image]
    """Of an upright picture at any resolution."""
    intrinsics: NDArray[np.float64]
    """Of the picture that it returns, in pixels of the stored size."""


@dataclass(frozen=True)
class StoredCamera:
    """One camera in OpenCV axes: a 4x4 pose and 3x3 intrinsics in pixels of an image of ``size``, height and width."""

    world_from_camera: NDArray[np.float64]
    intrinsics: NDArray[np.float64]
    size: tuple[int, int]
    undistortion: Undistortion | None = None

    def for_size(self, height: int, width: int) -> NDArray[np.float64]:
        """Intrinsics in pixels of the same image stored at another resolution."""
        scale = np.array([width / self.size[1], height / self.size[0], 1.0])
        return self.intrinsics * scale[:, None]


class CameraReader(Socket, ABC):
    """Reads the cameras that a program stored for photographs."""

    expects: ClassVar[str]
    """What it reads, for messages: ``a COLMAP model``."""
    rank: ClassVar[int] = 0
    """Of several programs whose cameras lie in one folder, the one of lowest rank is read."""

    @abstractmethod
    def find(self, path: Path) -> Path | None:
        """The file or folder with cameras: a given file itself, or what a folder holds; ``None`` if it is not there.

        Its content is only read to distinguish it from other files of the same suffix.
        """

    @abstractmethod
    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        """The cameras by the names of image files as the program stores them: with folders and suffix, or without.

        Args:
            path: What :meth:`find` returned.
            images: The photographs, in natural order, where there are any. Cameras that the program stores without a
                name or size cannot be read without.

        Raises:
            UserError: The file is damaged, or a lens has a model that cannot be undistorted.
        """

    def photographs(self, path: Path) -> Path | None:
        """The folder in which the program keeps the photographs of the cameras in ``path``, where it has one."""
        return None


def readers() -> list[CameraReader]:
    """All readers of the catalog, by rank."""
    return sorted((build(CameraReader, name) for name in catalog().names("cameras")), key=lambda reader: reader.rank)
