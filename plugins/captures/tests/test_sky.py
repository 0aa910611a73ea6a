"""The sky is told from what is plain and near."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from anystyle.types import Cameras
from anystyle_captures.sky import find_sky, plain, without_sky
from anystyle_captures.stereo import plane_sweep
from tests.support.cards import World, arc

FOCAL, SIZE = 110.0, (96, 128)


def capture(cards, num_views=7):
    """Photographs of some cards under a grey sky, where they show it, and their cameras."""
    world, poses = World(0, cards=0), arc(num_views, 40)
    pictures = []
    for paint in (lambda colors: 0.4 * colors, np.ones_like):
        world.cards = [(middle, sides, paint(colors)) for middle, sides, colors in cards]
        pictures.append(np.stack([world.picture(pose, FOCAL, SIZE) for pose in poses]))
    images, outlines = (torch.from_numpy(shown).movedim(-1, 1).float() / 255 for shown in pictures)
    intrinsics = torch.tensor([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    cameras = Cameras(torch.from_numpy(poses).float()[None], intrinsics.expand(1, num_views, 3, 3).clone(), SIZE)
    return images, (outlines < 0.6).all(1), cameras


def test_a_plain_sky_is_found_up_to_the_outlines_before_it():
    """Below the horizon, as cameras that look down would have it, it is a floor."""
    middle, sides, paint = World(0, cards=0).cards[0]
    images, sky, cameras = capture([(middle + np.array([0, 4.7, 0]), sides, paint), *World(0).cards[1:]])
    stereo = plane_sweep(images, cameras)
    mask = find_sky(images, cameras, stereo)
    assert (mask & sky).sum() > 0.95 * sky.sum() and (mask & ~sky).sum() < 0.05 * sky.sum()
    settled = without_sky(images, cameras, stereo)
    assert torch.equal(settled.depth.isinf(), mask) and not settled.support[mask].any()
    tilt = torch.tensor([[1.0, 0, 0, 0], [0, 0.6, 0.8, 0], [0, -0.8, 0.6, 0], [0, 0, 0, 1]])
    down = replace(cameras, world_from_camera=cameras.world_from_camera @ tilt)
    assert not find_sky(images, down, stereo).any()


@pytest.mark.parametrize("gray", [0.5, 0.9])
def test_a_plain_wall_is_none(gray):
    """It reaches the upper border and is of the sky's colour, but things beside it move against it."""
    near = np.array([0.4, -1.0, 0.0]), np.array([[0.5, 0.0, 0.0], [0.0, 1.5, 0.0]]), np.full((8, 8, 3), gray / 0.4)
    images, _, cameras = capture([World(0).cards[0], near])
    assert (plain(images).float().mean((1, 2)) > 0.1).all()
    assert not find_sky(images, cameras, plane_sweep(images, cameras)).any()
