"""Cameras from matches, and the descriptors that matches come from."""

import math

import pytest
import torch

from anystyle.types import Cameras, Geometry
from anystyle_backbones.aligner import Aligner

SIZE = (64, 64)
STRIDE = 4
CELLS = SIZE[0] // STRIDE
FOCAL = 60.0


def lenses(views):
    one = torch.tensor([[FOCAL, 0, SIZE[1] / 2], [0, FOCAL, SIZE[0] / 2], [0, 0, 1]])
    return Cameras(torch.eye(4).expand(1, views, 4, 4), one.expand(1, views, 3, 3), SIZE)


def ideal(points):
    """Logits of a matcher that knows the truth: the nearest cell, by distance, of the first view's points."""
    distance = torch.cdist(points[1].flatten(0, 1), points[0].flatten(0, 1))
    return (-(distance / 0.03).square()).unflatten(0, (CELLS, CELLS)).unflatten(2, (CELLS, CELLS))[None, None]


@pytest.mark.parametrize("cells", [1, 2])
def test_a_sideways_step_is_found(cells):
    """A plane straight ahead, seen by a camera that moved so far that points move by whole cells."""
    depth = torch.full((1, 2, *SIZE), 2.0)
    step = cells * STRIDE * 2.0 / FOCAL
    first, second = plane(), plane() + torch.tensor([step, 0.0, 0.0])
    pose = Aligner()(ideal([first, second]), lenses(2), depth)[0]
    assert torch.equal(pose[0], torch.eye(4))
    torch.testing.assert_close(pose[1, :3, 3], torch.tensor([step, 0.0, 0.0]), atol=0.03, rtol=0)
    assert math.degrees(math.acos(min(1.0, float((pose[1, :3, :3].trace() - 1) / 2)))) < 1.0


def plane():
    grid = (torch.arange(CELLS) + 0.5) * STRIDE
    v, u = torch.meshgrid(grid, grid, indexing="ij")
    return torch.stack([(u - 32) / FOCAL * 2, (v - 32) / FOCAL * 2, torch.full_like(u, 2.0)], dim=-1)


def test_poses_carry_no_gradient_and_views_are_independent():
    images = torch.rand(1, 3, 3, *SIZE, generator=torch.Generator().manual_seed(0), requires_grad=True)
    torch.manual_seed(0)
    aligner = Aligner().eval()
    correlation = aligner.correlation(images)
    assert correlation.shape == (1, 2, CELLS, CELLS, CELLS, CELLS) and correlation.requires_grad
    depth = torch.full((1, 3, *SIZE), 2.0)
    pose = aligner(correlation, lenses(3), depth)
    assert not pose.requires_grad
    swapped = aligner(aligner.correlation(images[:, [0, 2, 1]]), lenses(3), depth)
    torch.testing.assert_close(swapped[:, [0, 2, 1]], pose, atol=1e-3, rtol=1e-3)


def test_any_view_may_be_the_one_that_the_others_are_laid_upon():
    """As if it came first, and everything is put back after; of two scenes each has its own."""
    images = torch.rand(2, 3, 3, *SIZE, generator=torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    aligner = Aligner().eval()
    depth = 2 + torch.rand(2, 3, *SIZE, generator=torch.Generator().manual_seed(1))
    geometry = Geometry(lenses(3).expand(2), depth, depth)
    aligned = aligner.aligned(geometry, images, torch.tensor([2, 1]))
    for row, order in enumerate(([2, 0, 1], [1, 0, 2])):
        given = geometry.map(lambda tensor, row=row, order=order: tensor[row : row + 1, order])
        expected = aligner.aligned(given, images[row : row + 1, order]).cameras.world_from_camera[0]
        pose = aligned.cameras.world_from_camera[row]
        assert torch.equal(pose[order[0]], torch.eye(4))
        torch.testing.assert_close(pose[order], expected, atol=1e-4, rtol=1e-4)
    assert torch.equal(aligned.depth, depth)


def test_an_image_is_most_like_itself():
    torch.manual_seed(0)
    image = torch.rand(1, 1, 3, *SIZE)
    with torch.no_grad():
        alike = Aligner().correlation(image.expand(1, 2, -1, -1, -1))[0, 0].flatten(2).flatten(0, 1)
    assert torch.equal(alike.argmax(-1), torch.arange(CELLS**2))
    torch.testing.assert_close(alike.diagonal(), torch.full((CELLS**2,), 10.0), atol=1e-3, rtol=0)


def test_views_that_are_matched_one_at_a_time_have_the_poses_of_all_at_once():
    images = torch.rand(2, 4, 3, *SIZE, generator=torch.Generator().manual_seed(0))
    torch.manual_seed(0)
    aligner = Aligner()
    depth = 2 + torch.rand(2, 4, *SIZE, generator=torch.Generator().manual_seed(1))
    geometry, sizes = Geometry(lenses(4).expand(2), depth, depth), []
    expected = aligner.train().aligned(geometry, images).cameras.world_from_camera
    correlation = aligner.correlation
    aligner.correlation = lambda given: sizes.append(given.shape[1]) or correlation(given)
    torch.testing.assert_close(aligner.eval().aligned(geometry, images).cameras.world_from_camera, expected)
    assert sizes == [2, 2, 2]  # memory is that of a pair
