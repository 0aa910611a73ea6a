"""Where a picture shows what photographs have shown: closed forms of small clouds."""

from dataclasses import replace
from math import radians

import pytest
import torch

from anystyle.geometry.cameras import look_at
from anystyle.geometry.confidence import BEYOND, SPACING, ViewConfidence
from anystyle.geometry.harmonics import constant_from_rgb
from anystyle.types import Cameras, Gaussians

SIZE = (48, 64)
LEAST = SPACING[0]


def cameras(*degrees, distance=2.0, focal=60.0, size=SIZE):
    """Around the origin at the height of the horizon, looking at it."""
    turn = torch.tensor(degrees, dtype=torch.float32).deg2rad()
    eyes = distance * torch.stack([turn.sin(), torch.zeros_like(turn), -turn.cos()], dim=1)
    intrinsics = torch.tensor([[focal, 0, size[1] / 2], [0, focal, size[0] / 2], [0, 0, 1]])
    return Cameras(look_at(eyes, torch.zeros_like(eyes))[None], intrinsics.repeat(1, len(degrees), 1, 1), size)


def cloud(radius, number=2000):
    noise = torch.randn(number, 3, generator=torch.Generator().manual_seed(0))
    means = radius * noise / noise.norm(dim=1, keepdim=True)
    shape = torch.tensor([[1.0, 0, 0, 0]]).expand(number, 4), torch.full((number, 3), 0.01), torch.full((number,), 0.9)
    return Gaussians(*(each[None] for each in (means, *shape, constant_from_rgb(0.5 + 0 * means)[:, None])))


@pytest.mark.parametrize("degrees", [(0,), (0, 20, 40), range(0, 360, 24)])
@pytest.mark.parametrize("radius", [0.1, 0.8])
def test_it_is_one_where_photographs_were_taken_and_between_them_at_any_size(radius, degrees):
    seen = cameras(*degrees)
    confidence = ViewConfidence.of(cloud(radius), seen)
    for view in range(len(degrees)):
        for size in (SIZE, (97, 131)):
            assert (confidence(seen.select([view]).resized(size)) == 1).all()
    for left, right in zip(list(degrees), list(degrees)[1:], strict=False):
        assert (confidence(cameras((left + right) / 2)) > 0.999).all()


@pytest.mark.parametrize("apart", [5, 20, 60])
def test_it_falls_by_a_smooth_step_from_the_spacing_of_the_photographs_on(apart):
    """As seen from a point, so that every direction is that of the eye; and whichever way the eye turns aside."""
    confidence = ViewConfidence.of(cloud(1e-4), cameras(0, apart))
    begin = min(max(radians(apart), LEAST), SPACING[1])
    assert confidence.spacing == pytest.approx(begin, abs=1e-3)
    before = 1.0
    for beyond in range(0, 60, 3):
        share = min(max((radians(beyond) - begin) / BEYOND, 0.0), 1.0)
        shown = confidence(cameras(-beyond))
        torch.testing.assert_close(shown, torch.full((1, *SIZE), 1 - share**2 * (3 - 2 * share)), atol=5e-3, rtol=0)
        assert (shown <= before).all()
        before = shown


def test_nearer_and_farther_on_the_same_ray_is_as_well_known():
    confidence = ViewConfidence.of(cloud(1e-4), cameras(0))
    assert all((confidence(cameras(0, distance=distance)) == 1).all() for distance in (0.2, 2.0, 50.0))


def test_what_no_photograph_shows_is_not_known():
    """A sphere around a camera that looks ahead: behind it nothing is known, and beside it one side of the image."""
    seen = cameras(0, distance=0.01)
    confidence, sphere = ViewConfidence.of(cloud(1.0, 8000), seen), cloud(1.0, 8000)
    aside = look_at(seen.world_from_camera[0, :, :3, 3], torch.tensor([[0.5, 0.0, 0.87]]))  # by 30 degrees
    shown = confidence(Cameras(aside[None], seen.intrinsics, SIZE))[0]
    assert (shown[:, :12] > 0.95).all() and (shown[:, -12:] < 0.05).all()
    behind = look_at(seen.world_from_camera[0, :, :3, 3], torch.tensor([[0.0, 0.0, -1.0]]))
    assert (confidence(Cameras(behind[None], seen.intrinsics, SIZE)) == 0).all()
    assert (ViewConfidence.of(sphere.map(lambda tensor: tensor[:, :0]), seen)(seen) == 1).all()


def test_what_is_hidden_counts_for_nothing():
    """A cloud that the photograph shows, behind one beside its image."""
    near, far, seen = cloud(0.05), cloud(0.3), cameras(-75, focal=120.0)
    near = replace(near, means=near.means + torch.tensor([-1.2, 0.0, 0.0]))
    eye = cameras(-90, focal=120.0)
    alone = ViewConfidence.of(far, seen)(eye)[0]
    both = ViewConfidence.of(Gaussians.cat([near, far], dim=1), seen)(eye)[0]
    row, middle, beside = SIZE[0] // 2, SIZE[1] // 2, SIZE[1] // 2 + 14
    assert alone[row, middle] > 0.7 and both[row, middle] < 0.15
    assert alone[row, beside] > 0.7 and both[row, beside] > 0.6


def test_a_point_just_inside_the_corner_of_a_picture_is_in_its_last_cell():
    """Of 378 rows and 504 columns, the largest numbers below these are rounded up as they are divided into cells."""
    camera = Cameras(torch.eye(4)[None, None], torch.eye(3)[None, None], (378, 504))
    point = torch.cat([torch.tensor([504.0, 378.0]).nextafter(torch.zeros(2)), torch.ones(1)])[None]
    assert (ViewConfidence(point, torch.zeros(1, 1, 3), LEAST)(camera) == 0).all()
