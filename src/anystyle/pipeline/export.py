"""A scene as a file of any format, in the axes that its readers expect."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.geometry.cameras import looking_at
from anystyle.geometry.transforms import Similarity, y_up_from_opencv
from anystyle.pipeline.options import AXES
from anystyle.registry.build import build
from anystyle.types import Gaussians, StyledScene

Z_UP_FROM_OPENCV = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))


def export(gaussians: Gaussians, path: Path, name: str, *, up: str | None = None, notes: str = "") -> None:
    """Write one scene in one style; a page opens with a view of all of it."""
    cameras = looking_at(gaussians.means[0], gaussians.opacities[0])
    scene = StyledScene(((path.stem, gaussians),), cameras, ("all",), tuple(notes.splitlines()))
    export_styles(scene, path, name, up=up)


def export_styles(scene: StyledScene, path: Path, name: str, *, up: str | None = None) -> None:
    """Write a scene, whole or not at all; if the format has no field for notes, they are in ``NAME.txt`` beside it.

    Args:
        scene: In OpenCV's axes; styles may differ in colours and rotations only.
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
    styles = [
        (title, in_axes(up or writer.up, gaussians.map(lambda tensor: tensor[:, visible])))
        for title, gaussians in scene.styles
    ]
    writer.write(replace(scene, styles=tuple(styles)), path)
    if scene.notes and not writer.has_notes:
        path.with_suffix(path.suffix + ".txt").write_text("\n".join(scene.notes) + "\n", encoding="utf-8")


def in_axes(up: str, gaussians: Gaussians) -> Gaussians:
    """Gaussians rotated from OpenCV's axes to others; the same object where nothing changes."""
    return gaussians if up == "opencv" else _from_opencv(up, gaussians.means).gaussians(gaussians)


def from_axes(up: str, gaussians: Gaussians) -> Gaussians:
    """Gaussians rotated from other axes to OpenCV's; the same object where nothing changes."""
    return gaussians if up == "opencv" else _from_opencv(up, gaussians.means).inverse().gaussians(gaussians)


def _from_opencv(up: str, like: Tensor) -> Similarity:
    if up == "y":
        return y_up_from_opencv(like)
    if up == "z":
        return Similarity(like.new_ones(()), like.new_tensor(Z_UP_FROM_OPENCV), like.new_zeros(3))
    raise UserError(f"up={up}; choose one of {', '.join(AXES)}")
