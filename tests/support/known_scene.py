"""A scene that is known, photographed from cameras that are known."""

import torch

from anystyle.geometry.cameras import look_at
from anystyle.types import Cameras, Gaussians
from anystyle_captures.stereo import StereoDepth
from anystyle_cpu_renderer.renderer import CpuRenderer

SIZE = (40, 48)


def rig(num_views=7) -> Cameras:
    """Cameras on an arc around the origin."""
    angle = torch.linspace(-0.35, 0.35, num_views)
    eyes = 3 * torch.stack([angle.sin(), 0.2 * (5 * angle).sin(), -angle.cos()], 1)
    intrinsics = torch.tensor([[50.0, 0, SIZE[1] / 2], [0, 50.0, SIZE[0] / 2], [0, 0, 1]])
    return Cameras(look_at(eyes, torch.zeros(num_views, 3))[None], intrinsics.expand(1, num_views, 3, 3).clone(), SIZE)


def wall() -> Gaussians:
    """A bumpy wall of coloured, nearly opaque Gaussians that fills all images."""
    generator = torch.Generator().manual_seed(0)
    y, x = torch.meshgrid(torch.linspace(-2, 2, 33), torch.linspace(-2, 2, 33), indexing="ij")
    z = 0.3 * (2 * x).sin() * (1.5 * y).cos()
    n = x.numel()
    return Gaussians(
        means=torch.stack([x, y, z], -1).view(1, n, 3),
        rotations=torch.tensor([1.0, 0, 0, 0]).expand(1, n, 4),
        scales=torch.full((1, n, 3), 0.08),
        opacities=torch.full((1, n), 0.97),
        harmonics=1.2 * torch.rand(1, n, 1, 3, generator=generator) - 0.6,
    )


def photographed_wall(num_views=7):
    """Photographs, cameras and depths."""
    cameras = rig(num_views)
    with torch.no_grad():
        renders = CpuRenderer(background=(0.0, 0.0, 0.0))(wall(), cameras)
    return renders.color[0], cameras, renders.depth[0] / renders.alpha[0]


def stereo_of(depth, support=None):
    """Depths as stereo finds them, supported by one view where nothing else is said."""
    ones = torch.ones_like(depth)
    return StereoDepth(depth, ones, ones.int() if support is None else support, 0 * ones)
