"""A scene as nerfstudio has one: a data folder, and the folder of a run whose model is the scene."""

import json
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
import torch
from plyfile import PlyData, PlyElement

from anystyle.geometry.harmonics import rgb_from_constant
from anystyle.io.atomic import write_json
from anystyle.io.sheet import save_png, to_pil
from anystyle.pipeline.export import export_styles, in_axes
from anystyle.types import Cameras, Gaussians, Renders, StyledScene
from anystyle_formats.nerfstudio.checkpoint import STEP
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
    gaussians, turned = scene.styles[-1][1], in_axes("z", scene)
    data, run = folder / experiment / "data", folder / experiment / METHOD / RUN
    (data / "images").mkdir(parents=True)
    for view, name in enumerate(scene.names):
        image = render(gaussians, scene.cameras.select([view])).color[0, 0]
        save_png(to_pil(image), data / "images" / f"{name}.png")
    write_json(data / "transforms.json", _transforms(turned.cameras, turned.names))
    _write_points(turned.styles[-1][1], data / "sparse_pc.ply")
    (run / "nerfstudio_models").mkdir(parents=True)
    export_styles(turned, run / "nerfstudio_models" / f"step-{STEP:09d}.ckpt", "ckpt")
    write_json(run / TRANSFORMS, {"transform": torch.eye(4)[:3].tolist(), "scale": 1.0})
    # YAML that names nerfstudio's classes: what a class has as a plain default is left out, what it makes anew for
    # each instance has to be there. JSON's strings are YAML's.
    template = Template((files("anystyle_formats") / "nerfstudio" / "config.yml.in").read_text(encoding="utf-8"))
    values = {"experiment": experiment, "run": RUN, "output": str(final), "data": str(final / experiment / "data")}
    degree = max(1, round(gaussians.harmonics.shape[2] ** 0.5) - 1)
    text = template.substitute({name: json.dumps(value) for name, value in values.items()}, degree=degree)
    (run / CONFIG).write_text(text, encoding="utf-8")
    return (run / CONFIG).relative_to(folder)


def _transforms(cameras: Cameras, names: tuple[str, ...]) -> dict[str, object]:
    """Cameras as ``transforms.json``: poses with OpenGL's axes (x right, y up, z back), intrinsics in pixels."""
    poses = cameras.world_from_camera[0].double().cpu() * torch.tensor([1.0, -1.0, -1.0, 1.0], dtype=torch.float64)
    rows = zip(names, poses.tolist(), cameras.intrinsics[0].double().tolist(), strict=True)
    frames = [
        {"file_path": f"images/{name}.png", "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "transform_matrix": pose}
        for name, pose, ((fx, _, cx), (_, fy, cy), _) in rows
    ]
    height, width = cameras.size
    return {"camera_model": "PINHOLE", "w": width, "h": height, "ply_file_path": "sparse_pc.ply", "frames": frames}


def _write_points(gaussians: Gaussians, path: Path) -> None:
    """Write the centres of the most opaque Gaussians with their colours, as a PLY file of points."""
    opacities = gaussians.opacities[0].cpu()
    index = opacities.argsort(descending=True, stable=True)[: min(MAX_POINTS, int((opacities > 0).sum()))]
    rgb = (rgb_from_constant(gaussians.harmonics[0, :, 0].cpu()[index]).clamp(0, 1) * 255).round()
    values = torch.cat([gaussians.means[0].cpu()[index], rgb], 1).detach().double().numpy()
    kinds = [*((axis, "<f4") for axis in "xyz"), *((color, "u1") for color in ("red", "green", "blue"))]
    rows = np.array([tuple(row) for row in values], kinds)
    PlyData([PlyElement.describe(rows, "vertex")]).write(str(path))
