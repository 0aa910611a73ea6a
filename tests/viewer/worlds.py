"""A scene for tests of the viewer: nothing alike left and right, up and down."""

import json
from functools import partial
from pathlib import Path
from typing import NamedTuple

import torch

import anystyle
from anystyle.commands.view import rendered
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.inference.encoding import encode_splat
from anystyle.inference.options import SplatOptions, ViewOptions
from anystyle.inference.stages import Stages
from anystyle.types import Cameras, Gaussians
from anystyle.viewer.flight import Render
from anystyle.viewer.session import OpenScene, opened_scene

SIZE = (336, 448)
FOCAL = 370.0
WORDS = ("views.short_side=112",)


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


class World(NamedTuple):
    """A scene in a file, opened, and what renders it."""

    path: Path
    opened: OpenScene
    render: Render


def world_in(folder, short_side=112):
    """The scene as a file with one camera beside it."""
    path = folder / "scene.ply"
    scene().save(path)
    flip = [[1, 0, 0, 0], [0, -1, 0, 0], [0, 0, -1, 0], [0, 0, 0, 1]]
    size = {"w": SIZE[1], "h": SIZE[0], "cx": SIZE[1] / 2, "cy": SIZE[0] / 2, "fl_x": FOCAL, "fl_y": FOCAL}
    (folder / "transforms.json").write_text(
        json.dumps({**size, "frames": [{"file_path": "front.png", "transform_matrix": flip}]})
    )
    stylizer = anystyle.load()
    encoded = encode_splat(path, stylizer, ViewOptions(short_side=short_side), SplatOptions(), stages=Stages())
    return World(path, opened_scene(encoded, notes=("branch: Apache-2.0",)), partial(rendered, stylizer))
