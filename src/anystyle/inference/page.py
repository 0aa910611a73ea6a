"""Scenes in several styles as one HTML page."""

from collections.abc import Sequence
from pathlib import Path

from anystyle.io import page, ply
from anystyle.types import Cameras, Gaussians


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
    page.write(path, entries, places(cameras), title=title, notes=notes.splitlines(), first=len(entries) - 1)


def places(cameras: Cameras) -> list[page.PageCamera]:
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
