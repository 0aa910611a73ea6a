"""A scene as nerfstudio keeps one: a data folder, and the folder of a run whose model is the scene."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.io.atomic import atomic_path, write_json
from anystyle.io.sheet import save_png, to_pil
from anystyle.pipeline.export import export_styles, in_axes
from anystyle.types import Cameras, Gaussians, Renders, StyledScene
from anystyle_formats.nerfstudio.checkpoint import STEP
from anystyle_formats.nerfstudio.config import config_text
from anystyle_formats.nerfstudio.run_folder import CONFIG, TRANSFORMS

MAX_POINTS = 100_000
METHOD, RUN = "splatfacto", "anystyle"

Render = Callable[[Gaussians, Cameras], Renders]


def write_experiment(scene: StyledScene, folder: Path, final: Path, experiment: str, render: Render) -> Path:
    """Write ``data`` and the run of one style; nerfstudio's model and data have the same coordinates, with z up.

    Args:
        scene: In one style, with cameras for images of the size to render.
        folder: Where to write.
        final: Where it will lie, which the configuration names.
        experiment: Name of the experiment's folder.
        render: Renders the images of the data folder.

    Returns:
        The configuration's path below ``folder``.
    """
    gaussians = scene.styles[-1][1]
    images = [render(gaussians, scene.cameras.select([view])).color[0, 0] for view in range(len(scene.names))]
    turned = in_axes("z", scene)
    data, run = folder / experiment / "data", folder / experiment / METHOD / RUN
    (data / "images").mkdir(parents=True)
    for name, image in zip(scene.names, images, strict=True):
        save_png(to_pil(image), data / "images" / f"{name}.png")
    write_json(data / "transforms.json", transforms_of(turned.cameras, turned.names))
    write_points(turned.styles[-1][1], data / "sparse_pc.ply")
    (run / "nerfstudio_models").mkdir(parents=True)
    export_styles(turned, run / "nerfstudio_models" / f"step-{STEP:09d}.ckpt", "ckpt")
    write_json(run / TRANSFORMS, {"transform": torch.eye(4)[:3].tolist(), "scale": 1.0})
    degree = max(1, round(gaussians.harmonics.shape[2] ** 0.5) - 1)
    text = config_text(final, final / experiment / "data", experiment=experiment, run=RUN, degree=degree)
    (run / CONFIG).write_text(text, encoding="utf-8")
    return (run / CONFIG).relative_to(folder)


def transforms_of(cameras: Cameras, names: tuple[str, ...]) -> dict[str, object]:
    """Cameras as ``transforms.json``: poses with OpenGL's axes (x right, y up, z back), intrinsics in pixels."""
    poses = cameras.world_from_camera[0].double().cpu() * torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)
    frames = [
        {
            "file_path": f"images/{name}.png",
            "fl_x": float(lens[0, 0]),
            "fl_y": float(lens[1, 1]),
            "cx": float(lens[0, 2]),
            "cy": float(lens[1, 2]),
            "transform_matrix": pose.tolist(),
        }
        for name, lens, pose in zip(names, cameras.intrinsics[0].double().cpu(), poses, strict=True)
    ]
    height, width = cameras.size
    sides = {"camera_model": "PINHOLE", "w": width, "h": height}
    return {**sides, "ply_file_path": "sparse_pc.ply", "frames": frames}


def write_points(gaussians: Gaussians, path: Path) -> None:
    """Write the centres of the most opaque Gaussians with their colours, as a PLY file of points."""
    opacities = gaussians.opacities[0].cpu()
    index = opacities.argsort(descending=True, stable=True)[: min(MAX_POINTS, int((opacities > 0).sum()))]
    rgb = (rgb_from_constant(gaussians.harmonics[0, :, 0].cpu()[index]).clamp(0, 1) * 255).round().byte()
    kinds = [*((axis, "<f4") for axis in "xyz"), *((color, "u1") for color in ("red", "green", "blue"))]
    rows = np.empty(len(index), kinds)
    for column, name in enumerate(rows.dtype.names or ()):
        values = gaussians.means[0].cpu()[index] if column < 3 else rgb
        rows[name] = values[:, column % 3].detach().numpy()
    with atomic_path(path) as temporary:
        PlyData([PlyElement.describe(rows, "vertex")]).write(str(temporary))
