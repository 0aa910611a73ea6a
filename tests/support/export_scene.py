"""A scene of two colours, its picture, and how well each format keeps it."""

from functools import cache

import torch

from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.pipeline.export import export_styles
from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians, StyledScene

SIZE = (60, 80)
LEAST = {"ply": 80, "ksplat": 45, "spz": 36, "sog": 34, "splat": 36}
"""PSNR in dB of a picture from the file against one from the scene; quantised formats lose a little."""


@cache
def scene(coefficients=4, count=400):
    """Nothing alike left and right, up and down: a red cloud above right, a green one below left, rods that lean."""
    generator = torch.Generator().manual_seed(0)
    means = torch.randn(count, 3, generator=generator) * torch.tensor([0.25, 0.2, 0.2])
    right = torch.arange(count) % 2 == 0
    means += torch.where(right[:, None], torch.tensor([0.5, -0.35, 3.0]), torch.tensor([-0.45, 0.3, 3.5]))
    rgb = torch.where(right[:, None], torch.tensor([0.9, 0.15, 0.1]), torch.tensor([0.1, 0.7, 0.2]))
    harmonics = torch.randn(count, coefficients, 3, generator=generator) * 0.15
    harmonics[:, 0] = constant_from_rgb(rgb + 0.05 * torch.randn(count, 3, generator=generator))
    return Gaussians(
        means=means[None],
        rotations=(torch.tensor([0.9, 0.1, 0.2, 0.37]) + 0.1 * torch.randn(count, 4, generator=generator))[None],
        scales=(torch.tensor([0.12, 0.02, 0.03]) * (0.5 + torch.rand(count, 3, generator=generator)))[None],
        opacities=(0.2 + 0.75 * torch.rand(count, generator=generator))[None],
        harmonics=harmonics[None],
    )


def export(gaussians, path, name, *, up=None, notes="", offset=(0.0, 0.0, 0.0)):
    """Write one scene in one style, without cameras."""
    styled = StyledScene(((path.stem, gaussians),), notes=tuple(notes.splitlines()), offset=offset)
    return export_styles(styled, path, name, up=up)


def camera():
    intrinsics = torch.tensor([[70.0, 0, 40], [0, 70.0, 30], [0, 0, 1]])
    return Cameras(torch.eye(4)[None, None], intrinsics[None, None], SIZE)


@cache
def picture(gaussians):
    return TorchRenderer()(gaussians, camera()).color[0, 0]


def psnr(first, second):
    return float(-10 * torch.log10((first - second).square().mean().clamp_min(1e-12)))
