"""The files of one stylized scene."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import save_file
from torch import Tensor

from anystyle.data.folder import SourceImage
from anystyle.export import write_video
from anystyle.geometry.cameras import smooth_path
from anystyle.sheet import Cell, contact_sheet, to_pil
from anystyle.stylizer import Stylizer
from anystyle.types import Cameras, Gaussians

RENDER_CHUNK = 4


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
) -> list[Image.Image]:
    """Write a scene's PLY, tensors, input views and video into ``directory``; return the views."""
    directory.mkdir(parents=True, exist_ok=True)
    gaussians.save(directory / "scene.ply")
    save_gaussians(gaussians, directory / "scene.safetensors")
    renders: list[Image.Image] = []
    (directory / "renders").mkdir()
    for name, image in zip(names, render_each(stylizer, gaussians, cameras), strict=True):
        renders.append(to_pil(image))
        renders[-1].save(directory / "renders" / f"{name}.png")
    size = tuple(max(2, round(side * path.scale / 2) * 2) for side in cameras.size)
    route = smooth_path(cameras, path.frames).resized((size[0], size[1]))
    write_video(render_each(stylizer, gaussians, route), directory / "video.mp4", fps=path.fps)
    return renders


def write_cameras(path: Path, cameras: Cameras, sources: Sequence[SourceImage]) -> None:
    """Write the cameras of one scene, with intrinsics in pixels of the source images, as readable JSON."""
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
    write_report(path, {"convention": convention, "views": views})


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
