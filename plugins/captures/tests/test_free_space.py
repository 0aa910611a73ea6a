"""What photographs see through is empty."""

import pytest
import torch

from anystyle.types import Cameras
from anystyle_captures import fit_loop
from anystyle_captures.fit_loop import FitLoop, FitOptions, InitialScene
from anystyle_captures.free_space import FreeSpace
from anystyle_captures.initial import lift
from anystyle_cpu_renderer.renderer import CpuRenderer
from tests.support.known_scene import photographed_wall, stereo_of


@pytest.fixture(scope="module")
def photographs():
    return photographed_wall()


def free_space(cameras: Cameras, depth: torch.Tensor, views: range) -> FreeSpace:
    """As stereo finds it where the depths of some views are supported."""
    support = torch.zeros(depth.shape, dtype=torch.int32)
    support[list(views)] = 1
    return FreeSpace.of(stereo_of(depth, support), cameras)


def points_at(cameras: Cameras, depth: torch.Tensor, view: int, fraction: float) -> torch.Tensor:
    """Points on the rays of a view's middle pixels, at a fraction of their depths."""
    rows, columns = torch.cartesian_prod(torch.arange(16, 24), torch.arange(20, 28)).unbind(1)
    at = torch.stack([columns + 0.5, rows + 0.5, torch.ones(64)], dim=1) @ cameras.intrinsics[0, view].inverse().T
    local = fraction * depth[view, rows, columns, None] * at
    return local @ cameras.world_from_camera[0, view, :3, :3].T + cameras.world_from_camera[0, view, :3, 3]


@pytest.mark.parametrize(
    ("fraction", "views", "empty"),
    [
        (0.5, range(7), True),
        (0.8, range(7), True),
        (1.0, range(7), False),  # on the wall
        (1.3, range(7), False),  # behind it
        (0.5, range(2, 5), True),
        (0.5, range(2, 4), False),  # two of the seven views that should see it
        (0.5, range(3, 4), False),
        (-0.5, range(7), False),  # behind the camera, and past the sides of all others
    ],
)
def test_what_two_views_see_past_is_empty(photographs, fraction, views, empty):
    _, cameras, depth = photographs
    found = free_space(cameras, depth, views).contains(points_at(cameras, depth, 3, fraction))
    assert found.shape == (64,) and bool((found == empty).all())


def test_what_more_views_have_on_a_surface_is_kept(photographs):
    """Three views whose depths are twice too far see past the wall, and four have it where it is."""
    _, cameras, depth = photographs
    wrong = depth.clone()
    wrong[:3] *= 2
    points = points_at(cameras, depth, 3, 1.0)
    assert not free_space(cameras, wrong, range(7)).contains(points).any()
    assert free_space(cameras, wrong, range(4)).contains(points).all()


def test_a_fit_removes_floaters(photographs, monkeypatch):
    monkeypatch.setattr(fit_loop, "PRUNE_EVERY", 1)
    images, cameras, depth = photographs
    pixels = torch.cartesian_prod(torch.arange(7), torch.arange(0, 40, 4), torch.arange(0, 48, 4))
    lifted = lift(images, cameras, depth[pixels.unbind(1)], pixels)
    start = InitialScene(lifted, free_space(cameras, depth, range(7)))
    run = FitLoop(images, cameras, start, CpuRenderer(), FitOptions(num_steps=50))
    count, middle = len(run.splats), ((pixels[:, 0] == 3) & (pixels[:, 1] == 20)).nonzero()[3:8, 0]
    halfway = 0.5 * (cameras.world_from_camera[0, 3, :3, 3] - lifted.means[middle])
    with torch.no_grad():
        run.splats.parameters["offsets"][middle] = halfway / run.splats.units[middle, None]
    run.advance()
    assert len(run.splats) == count - 5
    run.advance()
    assert len(run.splats) == count - 5, "what lies on the wall stays"
