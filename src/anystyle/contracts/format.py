"""Files of Gaussian scenes."""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

from anystyle.errors import UserError
from anystyle.registry.catalog import Pluggable
from anystyle.types import StyledScene


class Format(Pluggable, ABC):
    """A file format of Gaussian scenes; its name is the suffix of the files."""

    runtime = ("activated",)

    up: ClassVar[str] = "opencv"
    """Axes of the format's files, unless they say otherwise: ``opencv``, ``y`` or ``z`` up."""
    reads: ClassVar[bool] = False
    """Whether files are read, too."""
    has_notes: ClassVar[bool] = False
    """Whether a file has room for :attr:`~anystyle.types.StyledScene.notes`."""
    has_offset: ClassVar[bool] = False
    """Whether a file has room for :attr:`~anystyle.types.StyledScene.offset`."""

    has_antialiasing: ClassVar[bool] = False
    """Whether a file says that its Gaussians are :class:`~anystyle.types.AntialiasedGaussians`."""

    max_degree: ClassVar[int | None] = None
    """The highest degree of harmonics that a file has room for; ``None`` is any."""

    many_styles: ClassVar[bool] = False
    """Whether a file has room for several styles."""
    shared: ClassVar[tuple[str, ...]] = ()
    """Attributes of :class:`~anystyle.types.Gaussians` that all styles of a file have in common, such as ``means``.

    Without any, a style may move Gaussians or add some.
    """

    @abstractmethod
    def write(self, scene: StyledScene, path: Path) -> None:
        """Write a scene, whole or not at all.

        Args:
            scene: In the axes of :attr:`up` unless others were asked for; every Gaussian is visible, and its styles
                have in common what :attr:`shared` names. A format with room for one style takes the last.
            path: The file.

        Raises:
            UserError: The format cannot hold the scene.
        """

    def read(self, path: Path) -> StyledScene:
        """Read a scene in the file's own axes, which are its ``up``; without cameras where the file has none.

        Raises:
            UserError: The file is damaged, or none of this format.
        """
        raise UserError(f"{path}: files of this format are written, and not read")
