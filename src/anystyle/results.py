"""The files of one stylized scene."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import save_file
from torch import Tensor

from anystyle import colmap
from anystyle.data.folder import SourceImage
from anystyle.export import write_video
from anystyle.geometry.alignment import Similarity
from anystyle.geometry.cameras import smooth_path
from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.geometry.rotations import wxyz_from_matrix
from anystyle.sheet import Cell, contact_sheet, to_pil
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians

RENDER_CHUNK = 4
MOST_POINTS = 100_000
"""Points of a COLMAP export: what an optimisation of Gaussians starts from."""


@dataclass(frozen=True)
class Path3D:
    """A camera path for a video.

    Args:
        frames: How many frames.
        fps: Frames a second.
        scale: Size of a frame relative to the input views.
    """

    frames: int = 90
    fps: int = 30
    scale: float = 2.0


@torch.no_grad()
def render_each(stylizer: Stylizer, gaussians: Gaussians, cameras: Cameras) -> Iterator[Tensor]:
    """Render the views of one scene, a few at a time, as images of shape 3 H W on the CPU."""
    count = cameras.intrinsics.shape[1]
    for start in range(0, count, RENDER_CHUNK):
        chunk = cameras.select(list(range(start, min(start + RENDER_CHUNK, count))))
        yield from stylizer.render(gaussians, chunk).color[0].cpu()


def save_gaussians(gaussians: Gaussians, path: Path) -> None:
    """Write every tensor of some Gaussians, without the loss of the PLY's conventions, as safetensors."""
    tensors = {
        name: getattr(gaussians, name).detach().cpu().contiguous().clone()
        for name in ("means", "rotations", "scales", "opacities", "harmonics")
    }
    # One entry alone, for safetensors writes several in an order of chance.
    save_file(tensors, path, metadata={"format": "anystyle/1 gaussians"})


def write_scene(
    directory: Path,
    stylizer: Stylizer,
    gaussians: Gaussians,
    cameras: Cameras,
    *,
    names: Sequence[str],
    path: Path3D,
    targets: tuple[Sequence[str], Cameras] | None = None,
    y_up: bool = False,
) -> list[Image.Image]:
    """Write a scene's PLY, tensors, input views and video into ``directory``; return the views.

    Args:
        directory: Made where it is not there.
        stylizer: Renders.
        gaussians: The scene.
        cameras: Of the input views.
        names: Of the input views.
        path: The video's; it follows the targets where there are any.
        targets: Names and cameras of further views, rendered into ``targets/``.
        y_up: Turn the PLY to the axes that most viewers expect; everything else stays in OpenCV's.
    """
    directory.mkdir(parents=True, exist_ok=True)
    gaussians.save(directory / "scene.ply", y_up=y_up)
    save_gaussians(gaussians, directory / "scene.safetensors")
    renders = write_renders(directory / "renders", stylizer, gaussians, cameras, names)
    followed = cameras
    if targets is not None:
        followed = targets[1]
        write_renders(directory / "targets", stylizer, gaussians, followed, targets[0])
    size = tuple(max(2, round(side * path.scale / 2) * 2) for side in followed.size)
    route = smooth_path(followed, path.frames).resized((size[0], size[1]))
    write_video(render_each(stylizer, gaussians, route), directory / "video.mp4", fps=path.fps)
    return renders


def write_renders(
    folder: Path, stylizer: Stylizer, gaussians: Gaussians, cameras: Cameras, names: Sequence[str]
) -> list[Image.Image]:
    """Render views into PNGs of their names; return them."""
    folder.mkdir()
    renders: list[Image.Image] = []
    for name, image in zip(names, render_each(stylizer, gaussians, cameras), strict=True):
        renders.append(to_pil(image))
        renders[-1].save(folder / f"{name}.png")
    return renders


def write_cameras(
    path: Path, cameras: Cameras, sources: Sequence[SourceImage], known: Similarity | None = None
) -> None:
    """Write the cameras of one scene, with intrinsics in pixels of the source images, as readable JSON.

    Args:
        path: A JSON file.
        cameras: Of the input views.
        sources: Where the views come from.
        known: The way from the frame of known cameras to the scene's, where there are any.
    """
    views = []
    for place, source in enumerate(sources):
        intrinsics = source.source_intrinsics(cameras.intrinsics[0, place].cpu())
        views.append(
            {
                "name": source.name,
                "height": source.size[0],
                "width": source.size[1],
                "intrinsics": intrinsics.tolist(),
                "world_from_camera": cameras.world_from_camera[0, place].tolist(),
            }
        )
    convention = (
        "OpenCV axes (x right, y down, z forward); intrinsics in source pixels; lengths in the scene's own unit"
    )
    report: dict[str, object] = {"convention": convention, "views": views}
    if known is not None:
        report["scene_from_known"] = {
            "meaning": "scene = scale * rotation @ known + translation",
            "scale": float(known.scale),
            "rotation": known.rotation.tolist(),
            "translation": known.translation.tolist(),
        }
    write_report(path, report)


def write_colmap(
    folder: Path, gaussians: Gaussians, cameras: Cameras, sources: Sequence[SourceImage], *, binary: bool
) -> None:
    """Write one scene as a COLMAP model: cameras in source pixels, images, and the surest Gaussians as points.

    Args:
        folder: Such as ``out/colmap/sparse/0``.
        gaussians: Whose centres and constant colours become points.
        cameras: Of the input views.
        sources: Where the views come from.
        binary: Whether files are binary, as COLMAP's own, or text.
    """
    lenses, photographs = {}, {}
    motions, intrinsics = cameras.camera_from_world[0].double().cpu(), cameras.intrinsics[0].double().cpu()
    turns = wxyz_from_matrix(motions[:, :3, :3])
    for place, source in enumerate(sources):
        lens = source.source_intrinsics(intrinsics[place])
        parameters = (float(lens[0, 0]), float(lens[1, 1]), float(lens[0, 2]), float(lens[1, 2]))
        lenses[place + 1] = colmap.Camera("PINHOLE", source.size, parameters)
        name = source.path.name if source.path is not None else f"{source.name}.png"
        w, x, y, z = turns[place].tolist()
        tx, ty, tz = motions[place, :3, 3].tolist()
        photographs[place + 1] = colmap.Photograph(name, place + 1, (w, x, y, z), (tx, ty, tz))
    opacities = gaussians.opacities[0].detach().cpu()
    order = opacities.argsort(descending=True, stable=True)[: min(MOST_POINTS, int((opacities > 0).sum()))]
    rgb = rgb_from_constant(gaussians.harmonics[0, :, 0].detach().cpu()[order])
    points = gaussians.means[0].detach().cpu()[order].double().numpy()
    colors = (rgb.clamp(0, 1) * 255).round().byte().numpy()
    colmap.write(colmap.Model(lenses, photographs, points, colors), folder, binary=binary)


def write_report(path: Path, report: dict[str, object]) -> None:
    """Write a report as readable JSON."""
    path.write_text(json.dumps(report, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")


def write_sheet(
    path: Path,
    photographs: Sequence[Image.Image],
    columns: Sequence[tuple[str, Cell, Sequence[Cell]]],
    *,
    rows: int = 4,
) -> None:
    """Write the sheet: photographs on the left, then for each column its style on top and its renders below.

    Args:
        path: A PNG.
        photographs: The input views.
        columns: Title, style image if there is one, and one render for each photograph.
        rows: At most so many views, evenly chosen.
    """
    count = min(rows, len(photographs))
    chosen = [round(place * (len(photographs) - 1) / max(count - 1, 1)) for place in range(count)]
    pictured = any(style is not None for _, style, _ in columns)
    head: list[list[Cell]] = [[None, *(style for _, style, _ in columns)]] if pictured else []
    body: list[list[Cell]] = [[photographs[view], *(renders[view] for _, _, renders in columns)] for view in chosen]
    aspect = photographs[0].width / photographs[0].height
    cell = (224, round(224 / aspect)) if aspect >= 1 else (round(224 * aspect), 224)
    sheet = contact_sheet([*head, *body], column_titles=["photograph", *(title for title, _, _ in columns)], cell=cell)
    sheet.save(path)
