"""A scene as a file of any format, in the axes that its readers expect."""

import logging
from dataclasses import replace
from math import isqrt
from pathlib import Path

import torch
from torch import Tensor

from anystyle.contracts import Format
from anystyle.errors import UserError
from anystyle.geometry.transforms import Similarity
from anystyle.io.atomic import final
from anystyle.registry.build import build
from anystyle.types import StyledScene
from anystyle.types.scene import AXES

_log = logging.getLogger(__name__)


def export_styles(scene: StyledScene, path: Path, name: str, *, up: str | None = None) -> int:
    """Write a scene, whole or not at all; if the format has no field for notes, they are in ``NAME.txt`` beside it.

    Returns the size of the file in bytes.

    ``name`` is a plugin of kind ``format``; ``up`` one of :data:`~anystyle.types.scene.AXES`, or ``None`` for what
    readers of the format expect.
    """
    writer, place = build(Format, name), final(path)
    given, last = dict(scene.styles), scene.styles[-1][1]
    kept = {title: each for title, each in given.items() if each.shares(last, writer.shared)}
    if left_out := given.keys() - kept:
        line = "%s: styles of one file share %s; left out are those with others: %s"
        _log.warning(line, place, ", ".join(writer.shared), ", ".join(sorted(left_out)))
    visible = {title: each.opacities[0] > 0 for title, each in kept.items()}
    if len({len(rows) for rows in visible.values()}) == 1:  # they stay as many, and what is equal stays equal
        visible = dict.fromkeys(kept, torch.stack(list(visible.values())).any(0))
    shown, total = int(next(reversed(visible.values())).sum()), last.means.shape[1]
    if not all(bool(rows.any()) for rows in visible.values()):
        raise UserError("the scene has no Gaussians that are visible; there is nothing to export")
    styles = tuple(
        (title, each.map(lambda tensor, rows=visible[title]: tensor[:, rows])) for title, each in kept.items()
    )
    turned, degree = in_axes(up or writer.up, replace(scene, styles=styles)), isqrt(last.harmonics.shape[2]) - 1
    if shown < total:
        _log.warning("%s: %s of %s Gaussians are left out (with opacity 0)", place, f"{total - shown:,}", f"{total:,}")
    if writer.max_degree is not None and degree > writer.max_degree:
        _log.warning("%s: harmonics above degree %d are left out: it has no room for them", place, writer.max_degree)
    if any(scene.offset) and not writer.has_offset:
        _log.warning(
            "%s: the format has no room for the offset %s, which its positions lack",
            place,
            " ".join(f"{each:.17g}" for each in turned.offset),
        )
    if scene.antialiased and not writer.has_antialiasing:
        _log.warning("%s: the format cannot say that the scene was trained with antialiasing", place)
    writer.write(turned, path)
    if not writer.has_notes:
        beside = path.with_suffix(path.suffix + ".txt")
        beside.unlink(missing_ok=True)  # an earlier scene's
        if scene.notes:
            beside.write_text("\n".join(scene.notes) + "\n", encoding="utf-8", errors="backslashreplace")
    return path.stat().st_size


def in_axes(up: str, scene: StyledScene) -> StyledScene:
    """A scene turned to other axes; the same object where nothing changes."""
    if up == scene.up:
        return scene
    like = scene.styles[0][1].means
    turned = turn(scene.up, up, like)
    styles = tuple((title, turned.gaussians(gaussians)) for title, gaussians in scene.styles)
    poses = turned.poses(scene.cameras.world_from_camera.to(like))
    x, y, z = (turned.rotation.double().cpu() @ torch.tensor(scene.offset, dtype=torch.float64) + 0.0).tolist()
    cameras = replace(scene.cameras, world_from_camera=poses)
    return replace(scene, styles=styles, cameras=cameras, up=up, offset=(x, y, z))


def turn(before: str, after: str, like: Tensor) -> Similarity:
    """The rotation from coordinates in some axes to those in others."""
    return _from_opencv(after, like).after(_from_opencv(before, like).inverse())


def _from_opencv(up: str, like: Tensor) -> Similarity:
    if up not in AXES:
        raise UserError(f"up={up}; choose one of {', '.join(AXES)}")
    return Similarity(like.new_ones(()), like.new_tensor(AXES[up]), like.new_zeros(3))
