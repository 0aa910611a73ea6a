"""A scene for tests of the viewer: nothing alike left and right, up and down."""

import json

import torch

from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.types import Cameras, Gaussians

SIZE = (336, 448)
FOCAL = 370.0


def scene(count=2500):
    generator = torch.Generator().manual_seed(0)
    right = (torch.arange(count) % 2 == 0)[:, None]
    means = torch.randn(count, 3, generator=generator) * torch.tensor([0.35, 0.35, 0.15])
    means += torch.where(right, torch.tensor([0.5, -0.4, 3.0]), torch.tensor([-0.5, 0.3, 3.2]))
    rgb = torch.where(right, torch.tensor([0.85, 0.2, 0.1]), torch.tensor([0.1, 0.6, 0.25]))
    return Gaussians(
        means=means[None],
        rotations=torch.randn(1, count, 4, generator=generator),
        scales=0.02 + 0.05 * torch.rand(1, count, 3, generator=generator),
        opacities=0.5 + 0.49 * torch.rand(1, count, generator=generator),
        harmonics=constant_from_rgb(rgb)[None, :, None],
    )


def camera(pose=None):
    intrinsics = torch.tensor([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    return Cameras((torch.eye(4) if pose is None else pose)[None, None], intrinsics[None, None], SIZE)


def write_scene(folder):
    """The scene as a file with one camera beside it."""
    path = folder / "scene.ply"
    scene().save(path)
    flip = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
    size = {"w": SIZE[1], "h": SIZE[0], "cx": SIZE[1] / 2, "cy": SIZE[0] / 2, "fl_x": FOCAL, "fl_y": FOCAL}
    frames = [{"file_path": "front.png", "transform_matrix": flip}]
    (folder / "transforms.json").write_text(json.dumps({**size, "frames": frames}))
    return path
