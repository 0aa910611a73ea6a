"""A scene as a file of any format, in the axes that its readers expect."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from torch import Tensor

from anystyle.errors import did_you_mean
from anystyle.geometry.similarity import Similarity, y_up_from_opencv
from anystyle.io import page, ply
from anystyle.io.formats import glb, sog, spz
from anystyle.io.formats import splat as splat_file
from anystyle.types import Cameras, Gaussians

UP = ("opencv", "y", "z")
"""Axes: x right, y down, z forward; x right, y up, z back; x right, y forward, z up. All are right-handed."""

Z_UP_FROM_OPENCV = ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0))


class Format(NamedTuple):
    """How a format is written, and the axes that its readers take it to be in."""

    write: Callable[[ply.Splats, Path, str], None]
    up: str
    notes: bool


FORMATS = {
    "ply": Format(ply.write, "opencv", True),
    "glb": Format(glb.write, "y", True),
    "spz": Format(spz.write, "y", False),
    "sog": Format(sog.write, "opencv", True),
    "splat": Format(splat_file.write, "opencv", False),
}
"""By suffix. 3DGS and what comes from it have OpenCV's axes; glTF and SPZ say y up."""


def format_of(name: str) -> Format:
    """A format by name.

    Raises:
        ValueError: There is none of that name.
    """
    if name not in FORMATS:
        known = (*FORMATS, "html")
        raise ValueError(f"no format is named {name!r}.{did_you_mean(name, known)} Formats: {', '.join(known)}")
    return FORMATS[name]


def export(gaussians: Gaussians, path: Path, name: str, *, up: str | None = None, notes: str = "") -> None:
    """Write one scene; whole or not at all. What a format has no room for lies beside it as ``NAME.txt``.

    Args:
        gaussians: A batch of one, in OpenCV's axes.
        path: The file.
        name: A key of :data:`FORMATS`.
        up: One of :data:`UP`; ``None`` is what readers of the format expect.
        notes: Such as licences.

    Raises:
        ValueError: There is no such format or axes, or the scene has no Gaussians.
    """
    chosen = format_of(name)
    seen = gaussians.opacities[0] > 0
    if not bool(seen.any()):
        raise ValueError("the scene has no Gaussians that are visible; there is nothing to export")
    turned = in_axes(up or chosen.up, gaussians)
    tensors = (turned.means, turned.rotations, turned.scales, turned.opacities, turned.harmonics)
    chosen.write(ply.Splats(*(tensor[0][seen] for tensor in tensors)), path, notes)
    if notes and not chosen.notes:
        path.with_suffix(path.suffix + ".txt").write_text(notes + "\n", encoding="utf-8")


def in_axes(up: str, gaussians: Gaussians) -> Gaussians:
    """Gaussians in OpenCV's axes turned to others; the same ones where nothing changes.

    Raises:
        ValueError: There are no such axes.
    """
    return gaussians if up == "opencv" else _turn(up, gaussians.means).gaussians(gaussians)


def from_axes(up: str, gaussians: Gaussians) -> Gaussians:
    """Gaussians in other axes turned to OpenCV's; the same ones where nothing changes.

    Raises:
        ValueError: There are no such axes.
    """
    return gaussians if up == "opencv" else _turn(up, gaussians.means).inverse().gaussians(gaussians)


def _turn(up: str, like: Tensor) -> Similarity:
    """From OpenCV's axes."""
    if up == "y":
        return y_up_from_opencv(like)
    if up == "z":
        return Similarity(like.new_ones(()), like.new_tensor(Z_UP_FROM_OPENCV), like.new_zeros(3))
    raise ValueError(f"up={up}; choose one of {', '.join(UP)}")


def write_page(
    path: Path, styles: Sequence[tuple[str, Gaussians]], cameras: Cameras, *, title: str = "", notes: str = ""
) -> None:
    """Write one scene in its styles; whole or not at all. The last style is shown at first.

    Args:
        path: An ``.html`` file.
        styles: Titles, and batches of one scene in OpenCV's axes, all of one geometry.
        cameras: A batch of one scene; the page begins at the first.
        title: For people.
        notes: Lines of the caption, such as licences.

    Raises:
        ValueError: Styles are not of one geometry, or nothing is visible.
    """
    seen = styles[0][1].opacities[0] > 0
    if not bool(seen.any()):
        raise ValueError("the scene has no Gaussians that are visible; there is nothing to show")
    entries: list[page.PageStyle] = []
    for name, gaussians in styles:
        tensors = (gaussians.means, gaussians.rotations, gaussians.scales, gaussians.opacities, gaussians.harmonics)
        if gaussians.means.shape[1] != len(seen):
            raise ValueError(f"the style {name!r} has other Gaussians than {styles[0][0]!r}; one page, one scene")
        entries.append(page.PageStyle(name, ply.Splats(*(tensor[0][seen] for tensor in tensors))))
    page.write(path, entries, page_cameras(cameras), title=title, notes=notes.splitlines(), first=len(entries) - 1)


def page_cameras(cameras: Cameras) -> list[page.PageCamera]:
    """Cameras of one scene as a page has them."""
    height, width = cameras.size
    poses, intrinsics = cameras.world_from_camera[0].cpu(), cameras.intrinsics[0].cpu()
    return [
        page.PageCamera(
            position=pose[:3, 3].tolist(),
            axes=pose[:3, :3].mT.tolist(),
            focal=(float(matrix[0, 0]), float(matrix[1, 1])),
            center=(float(matrix[0, 2]), float(matrix[1, 2])),
            size=(width, height),
        )
        for pose, matrix in zip(poses, intrinsics, strict=True)
    ]
