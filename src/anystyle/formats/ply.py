"""3DGS PLY files as a plugin; :mod:`anystyle.io.ply` reads and writes them."""

from pathlib import Path

from anystyle.contracts import Format
from anystyle.io import ply
from anystyle.types import StyledScene


class Ply(Format):
    """The PLY layout of 3DGS, which most viewers open."""

    has_notes = True

    def write(self, scene: StyledScene, path: Path) -> None:
        ply.write(scene.splats(), path, "\n".join(scene.notes))
