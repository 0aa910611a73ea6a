"""A scene as a file of any format, in the axes that its readers expect."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity
from anystyle.pipeline.options import AXES
from anystyle.registry.build import build
from anystyle.types import Gaussians, StyledScene

_FROM_OPENCV = {
    "opencv": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
}


def export(gaussians: Gaussians, path: Path, name: str, *, up: str | None = None, notes: str = "") -> None:
    """Write one scene in one style, without cameras."""
    export_styles(StyledScene(((path.stem, gaussians),), notes=tuple(notes.splitlines())), path, name, up=up)


def export_styles(scene: StyledScene, path: Path, name: str, *, up: str | None = None) -> None:
    """Write a scene, whole or not at all; if the format has no field for notes, they are in ``NAME.txt`` beside it.

    Args:
        scene: Styles may differ in colours and rotations only.
        path: The file.
        name: A plugin of kind ``format``.
        up: One of :data:`~anystyle.pipeline.options.AXES`; ``None`` is what readers of the format expect.
    """
    writer = build(Format, name)
    first, given = scene.styles[0][0], dict(scene.styles)
    for title, gaussians in given.items():
        if gaussians.means.shape != given[first].means.shape:
            raise UserError(f"the style {title!r} has other Gaussians than {first!r}; one file, one scene")
    visible = torch.stack([gaussians.opacities[0] > 0 for gaussians in given.values()]).any(0)
    if not bool(visible.any()):
        raise UserError("the scene has no Gaussians that are visible; there is nothing to export")
    styles = tuple((title, gaussians.map(lambda tensor: tensor[:, visible])) for title, gaussians in scene.styles)
    writer.write(in_axes(up or writer.up, replace(scene, styles=styles)), path)
    if not writer.has_notes:
        beside = path.with_suffix(path.suffix + ".txt")
        beside.unlink(missing_ok=True)  # an earlier scene's
        if scene.notes:
            beside.write_text("\n".join(scene.notes) + "\n", encoding="utf-8", errors="backslashreplace")


def in_axes(up: str, scene: StyledScene) -> StyledScene:
    """A scene turned to other axes; the same object where nothing changes."""
    if up == scene.up:
        return scene
    like = scene.styles[0][1].means
    turn = _from_opencv(up, like).after(_from_opencv(scene.up, like).inverse())
    styles = tuple((title, turn.gaussians(gaussians)) for title, gaussians in scene.styles)
    poses = turn.poses(scene.cameras.world_from_camera.to(like))
    return replace(scene, styles=styles, cameras=replace(scene.cameras, world_from_camera=poses), up=up)


def _from_opencv(up: str, like: Tensor) -> Similarity:
    if up not in _FROM_OPENCV:
        raise UserError(f"up={up}; choose one of {', '.join(AXES)}")
    return Similarity(like.new_ones(()), like.new_tensor(_FROM_OPENCV[up]), like.new_zeros(3))
