"""The formats of Gaussian scenes that come with the core: 3DGS PLY, as :mod:`anystyle.io.ply` reads and writes it."""

import re
from dataclasses import replace
from pathlib import Path

import torch

from anystyle.contracts import Format
from anystyle.io import ply
from anystyle.types import Cameras, Gaussians, StyledScene
from anystyle.types.scene import AXES

_UP = {name: tuple(0.0 - row[1] for row in rotation) for name, rotation in AXES.items()}
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"


class Ply(Format):
    """The PLY layout of 3DGS, which most viewers open.

    Comments name the axes as Brush does, and an offset as DJI Terra does.

    Args:
        activated: Whether files that are read hold lengths and opacities in [0, 1] in place of logarithms and logits.
    """

    has_antialiasing = has_notes = has_offset = reads = True

    def __init__(self, *, activated: bool = False) -> None:
        self.activated = activated

    def write(self, scene: StyledScene, path: Path) -> None:
        ply.write(scene.splats(), path, comments(scene))

    def read(self, path: Path) -> StyledScene:
        loaded, notes = ply.load(path, activated=self.activated), ply.comments(path)
        axes = [note for note in notes if note.lower().startswith("vertical axis:")]
        offsets = {note: match for note in notes if (match := re.fullmatch(rf"offset([xyz])\s+({_NUMBER})", note))}
        said = {match[1]: float(match[2]) for match in offsets.values()}
        x, y, z = (moved + said.get(axis, 0.0) for axis, moved in zip("xyz", loaded.offset, strict=True))
        modes = list(filter(ply.is_antialiased, notes))
        others = tuple(note for note in notes if note not in (*axes, *offsets, *modes))
        gaussians = Gaussians(*(tensor[None] for tensor in loaded.splats)).marked(bool(modes))
        scene = StyledScene(
            ((path.stem, gaussians),), notes=others, up=_axes(axes[-1] if axes else ""), offset=(x, y, z)
        )
        if loaded.camera is None:
            return scene
        pose = loaded.camera.camera_from_world.inverse()
        pose[:3, 3] -= torch.tensor(loaded.offset)
        cameras = Cameras(pose[None, None], loaded.camera.intrinsics[None, None], loaded.camera.size)
        return replace(scene, cameras=cameras, names=("photograph",))


def comments(scene: StyledScene) -> list[str]:
    """The comments of a file: notes, how it was trained, axes, and the offset if there is one."""
    offset = [f"offset{axis} {value:.17g}" for axis, value in zip("xyz", scene.offset, strict=True)]
    axes = "Vertical axis: " + " ".join(f"{part:g}" for part in _UP[scene.up])
    return [*scene.notes, *[ply.ANTIALIASED] * scene.antialiased, axes, *(offset if any(scene.offset) else [])]


def _axes(comment: str) -> str:
    """The axes nearest to what a comment says.

    Brush and this program name the direction that is up, such as ``0 0 1``. Where Brush does not know it, it says
    ``y`` and means 3DGS's axes; nerfstudio says ``z``.
    """
    parts = [float(part) for part in re.findall(_NUMBER, comment)[:3]]
    if len(parts) == 3:
        return max(_UP, key=lambda name: sum(a * b for a, b in zip(_UP[name], parts, strict=True)))
    return "z" if comment.lower().endswith(": z") else "opencv"
