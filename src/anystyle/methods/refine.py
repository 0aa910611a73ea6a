"""Gaussians moved, turned and stretched so that they show painted strokes."""

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.methods.gaussian_parameters import GaussianParameters
from anystyle.types import Cameras, Gaussians

RATES = {"colors": 0.02, "scales": 0.03, "rotations": 0.004, "offsets": 0.03}
"""Learning rates of Adam; centres in units of each Gaussian's mean scale."""


def refine(
    gaussians: Gaussians,
    cameras: Cameras,
    targets: Float[Tensor, "V 3 H W"],
    confidence: Float[Tensor, "V 1 H W"],
    renderer: Renderer,
    *,
    steps: int,
) -> Gaussians:
    """Lower the mean absolute error of renders, by Adam on one view per step; opacities stay.

    Args:
        gaussians: A batch of one scene, coloured.
        cameras: A batch of one scene, for images of the targets' size.
        targets: sRGB in [0, 1].
        confidence: Weights of pixels.
        renderer: Differentiable in all attributes.
        steps: Each a render of one view and its backward pass.
    """
    parameters = GaussianParameters(gaussians, RATES, gaussians.scales[0].mean(-1))
    generator, left = torch.Generator().manual_seed(0), list[int]()
    for _ in range(steps):
        left = left or torch.randperm(len(targets), generator=generator).tolist()
        view = left.pop()
        color = renderer(parameters.gaussians(), cameras.select([view])).color[0, 0]
        ((color - targets[view]).abs() * confidence[view]).mean().backward()
        parameters.adam.step()
    return parameters.gaussians().detach()
