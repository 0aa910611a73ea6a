"""3DGS PLY files as a plugin; :mod:`anystyle.io.ply` reads and writes them."""

import re
from pathlib import Path

from anystyle.contracts import Format
from anystyle.io import ply
from anystyle.types import Gaussians, StyledScene

_UP = {"opencv": (0.0, -1.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}


class Ply(Format):
    """The PLY layout of 3DGS, which most viewers open, with a comment on the axes as Brush writes it."""

    has_notes = reads = True

    def write(self, scene: StyledScene, path: Path) -> None:
        axis = "Vertical axis: " + " ".join(f"{part:g}" for part in _UP[scene.up])
        ply.write(scene.splats(), path, "\n".join([*scene.notes, axis]))

    def read(self, path: Path) -> StyledScene:
        gaussians = Gaussians.load(path)
        with path.open("rb") as file:
            header = file.read(1 << 16).partition(b"end_header")[0].decode("ascii", "replace")
        notes = re.findall(r"^comment +(.*\S)", header, re.MULTILINE)
        said = [note for note in notes if note.lower().startswith("vertical axis:")]
        others = tuple(note for note in notes if note not in said)
        return StyledScene(((path.stem, gaussians),), notes=others, up=_axes(said[-1] if said else ""))


def _axes(comment: str) -> str:
    """The axes nearest to what a comment says.

    Brush and this program name the direction that is up, such as ``0 0 1``. Where Brush does not know it, it says
    ``y`` and means 3DGS's axes; nerfstudio says ``z``.
    """
    parts = [float(part) for part in re.findall(r"[-+.\d]+(?:e[-+]?\d+)?", comment)[:3]] if comment else []
    if len(parts) == 3:
        return max(_UP, key=lambda name: sum(a * b for a, b in zip(_UP[name], parts, strict=True)))
    return "z" if comment.lower().endswith(": z") else "opencv"
