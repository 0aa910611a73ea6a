"""The median depth of a scene whose depth is known."""

from dataclasses import replace

import torch

from anystyle.renderers.torch import TorchRenderer
from anystyle.types import Cameras, Gaussians
from anystyle_captures.median_depth import median_depth


def test_a_backdrop_does_not_move_the_depth_of_a_surface_that_lets_some_of_it_through():
    """A tilted wall before a farther one; in the expected depth, the second has its share."""
    side = torch.linspace(-3, 3, 25)
    x, y = (axis.flatten() for axis in torch.meshgrid(side, side, indexing="xy"))
    wall, back = torch.stack([x, y, 4 + 0.2 * x], -1), torch.stack([4 * x, 4 * y, torch.full_like(x, 16)], -1)
    means = torch.cat([wall, back])
    gaussians = Gaussians(
        means=means[None],
        rotations=torch.tensor([1.0, 0, 0, 0]).expand(1, len(means), 4),
        scales=torch.tensor([0.15, 0.15, 1e-3]) * (means[None, :, 2:] > 10).float().mul(3).add(1),
        opacities=torch.where(means[:, 2] > 10, 0.99, 0.6)[None],
        harmonics=torch.zeros(1, len(means), 1, 3),
    )
    cameras = Cameras(torch.eye(4)[None, None], torch.tensor([[[[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]]]), (24, 32))
    renders = TorchRenderer()(gaussians, cameras)
    expected = (renders.depth / renders.alpha)[0, 0]
    column = (torch.arange(32) + 0.5 - 16) / 30
    true = (4 / (1 - 0.2 * column)).expand(24, 32)
    found = median_depth(gaussians, cameras, TorchRenderer())[0, 0]
    assert float((found / true - 1).abs().median()) < 0.03 < float((expected / true - 1).abs().median())
    nothing = replace(gaussians, opacities=0.1 * gaussians.opacities)
    assert not median_depth(nothing, cameras, TorchRenderer()).any()
