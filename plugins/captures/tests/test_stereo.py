"""Depths by stereo in exact pictures of a known world."""

import torch

from anystyle_captures.stereo import plane_sweep
from tests.support.cards import photographed


def test_what_is_near_is_found_though_no_point_lies_on_it():
    """Cards before the wall, which alone has known points, at depths of 4.6 to 5.7."""
    images, cameras = photographed(7)
    side = torch.linspace(-1, 1, 6)
    points = [torch.cartesian_prod(side, side, torch.tensor([2.5]))] * 7
    found = plane_sweep(images, cameras, points=points)
    assert ((found.depth < 0.6 * 4.6) & (found.support > 1)).double().mean() > 0.05
    # Where no depth agrees, the points are all that is known.
    assert plane_sweep(torch.full_like(images, 0.5), cameras, points=points).depth.isfinite().all()
