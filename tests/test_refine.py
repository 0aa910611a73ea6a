"""Cameras refined from matches, on a made world whose cameras are known."""

from dataclasses import replace

import pytest
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.geometry.bundle import Bundle, Tracks, adjust
from anystyle.geometry.matching import describe_points, grid_points, match_points
from anystyle.inference.refine import refine
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.types import Geometry, Scene, Views
from anystyle_tiny.procedural.scenes import ProceduralScenes


def turned(pose: Float[Tensor, "V 4 4"], amount: float, seed: int) -> Float[Tensor, "V 4 4"]:
    """Cameras but the first turned and moved at random by about so many radians and units."""
    generator = torch.Generator().manual_seed(seed)
    skew = torch.zeros(len(pose), 4, 4)
    motion = amount * torch.randn(len(pose), 6, generator=generator)
    for (row, column), angle in zip(((2, 1), (0, 2), (1, 0)), motion[:, :3].T, strict=True):
        skew[:, row, column], skew[:, column, row] = angle, -angle
    skew[:, :3, 3] = motion[:, 3:]
    skew[0] = 0
    return torch.linalg.matrix_exp(skew) @ pose


def pose_errors(predicted: Float[Tensor, "V 4 4"], true: Float[Tensor, "V 4 4"]) -> tuple[Tensor, Tensor]:
    """Degrees by which the rotation and the direction of each view, seen from the first, are off."""
    (rotation, direction), (true_rotation, true_direction) = (
        (relative[1:, :3, :3], F.normalize(relative[1:, :3, 3], dim=-1))
        for relative in (poses[:1].inverse() @ poses for poses in (predicted, true))
    )
    cosine = ((rotation.mT @ true_rotation).diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
    direction_cosine = (direction * true_direction).sum(-1)
    return cosine.clamp(-1, 1).acos().rad2deg(), direction_cosine.clamp(-1, 1).acos().rad2deg()


@pytest.fixture(scope="module")
def views() -> Views:
    return ProceduralScenes(size=112, num_scenes=4, split="validation").read(1, [0, 2, 4])


def encoded(views: Views, pose: Float[Tensor, "V 4 4"]) -> tuple[Scene, ToyBackbone]:
    assert views.cameras is not None and views.depth is not None
    backbone = ToyBackbone(dim=12, depth=2)
    with torch.no_grad():
        scene = backbone.encode(views)
    cameras = replace(views.cameras, world_from_camera=pose[None])
    return replace(scene, geometry=Geometry(cameras, views.depth, torch.ones_like(views.depth))), backbone


def test_cameras_that_are_off_come_back(views: Views):
    assert views.cameras is not None
    true = views.cameras.world_from_camera[0]
    scene, backbone = encoded(views, turned(true, 0.05, 0))
    before = pose_errors(scene.cameras.world_from_camera[0], true)
    after = pose_errors(refine(scene, backbone.adapter).cameras.world_from_camera[0], true)
    assert before[0].min() > 2 and before[1].max() > 5
    assert after[0].max() < 0.8 and after[1].max() < 4


def test_scales_of_depth_come_back(views: Views):
    assert views.cameras is not None
    scene, backbone = encoded(views, views.cameras.world_from_camera[0])
    factors = torch.tensor([1.0, 1.2, 0.85])[None, :, None, None]
    wrong = replace(scene, geometry=replace(scene.geometry, depth=scene.geometry.depth * factors))
    ratio = (refine(wrong, backbone.adapter).geometry.depth / scene.geometry.depth).flatten(2).mean(-1)[0]
    assert float((ratio / ratio[0] - 1).abs().max()) < 0.05


def test_one_view_alone_and_a_blank_scene_stay(views: Views):
    assert views.cameras is not None
    alone = views.select([0])
    scene, backbone = encoded(alone, views.cameras.world_from_camera[0, :1])
    assert refine(scene, backbone.adapter) is scene
    blank = replace(views, images=torch.full_like(views.images, 0.5))
    scene, backbone = encoded(blank, views.cameras.world_from_camera[0])
    kept = refine(scene, backbone.adapter)
    assert torch.equal(kept.cameras.world_from_camera, scene.cameras.world_from_camera)


def test_clusters_follow_the_geometry(views: Views):
    assert views.cameras is not None
    scene, backbone = encoded(views, turned(views.cameras.world_from_camera[0], 0.05, 1))
    better = refine(scene, backbone.adapter)
    wanted = backbone.adapter.cluster(better.geometry, scene.attributes)
    assert (wanted is None) == (better.clusters is None)
    if wanted is not None and better.clusters is not None:
        assert torch.equal(better.clusters.means, wanted.means)


def test_the_same_scene_gives_the_same_bits(views: Views):
    assert views.cameras is not None
    scene, backbone = encoded(views, turned(views.cameras.world_from_camera[0], 0.05, 2))
    once, twice = (refine(scene, backbone.adapter).cameras.world_from_camera for _ in range(2))
    assert torch.equal(once, twice)


def test_the_camera_of_the_reference_stays_wherever_it_comes(views: Views):
    assert views.cameras is not None
    pose, order = turned(views.cameras.world_from_camera[0], 0.02, 0), [2, 0, 1]
    results = []
    for given, poses, reference in ((views, pose, 1), (views.select(order), pose[order], 2)):
        scene, backbone = encoded(given, poses)
        scene = replace(scene, stem=replace(scene.stem, reference=torch.tensor([reference])))
        results.append(refine(scene, backbone.adapter).geometry)
        torch.testing.assert_close(results[-1].cameras.world_from_camera[0, reference], poses[reference])
    first, other = results
    torch.testing.assert_close(
        first.cameras.world_from_camera[:, order], other.cameras.world_from_camera, atol=1e-3, rtol=0
    )
    torch.testing.assert_close(first.depth[:, order], other.depth, atol=0, rtol=1e-3)


def test_adjustment_finds_exact_cameras_of_exact_tracks():
    generator = torch.Generator().manual_seed(0)
    ray = 0.8 * (torch.rand(60, 2, generator=generator) - 0.5)
    depth = 2 + torch.rand(60, generator=generator)
    angle = torch.tensor(0.2)
    turn = torch.tensor([[angle.cos(), 0, angle.sin()], [0, 1, 0], [-angle.sin(), 0, angle.cos()]])
    shift = torch.tensor([-0.5, 0.1, 0.05])
    seen = torch.cat([ray, torch.ones(60, 1)], -1) * depth[:, None] @ turn.T + shift
    tracks = Tracks(
        view=torch.zeros(60, dtype=torch.long),
        ray=ray,
        log_depth=depth.log(),
        point=torch.arange(60),
        target=torch.ones(60, dtype=torch.long),
        observed=seen[:, :2] / seen[:, 2:],
        target_log_depth=seen[:, 2].log(),
        weight=torch.ones(60),
    )
    start = Bundle(torch.eye(3).repeat(2, 1, 1), torch.zeros(2, 3), torch.zeros(2), depth.log())
    found = adjust(start, tracks, doubtful=(1.0,) * 12, noise=0.01)
    assert torch.allclose(found.rotation[1], turn, atol=1e-3)
    assert torch.allclose(found.translation[1], shift, atol=1e-2)
    assert torch.equal(found.rotation[0], torch.eye(3))


def test_a_shifted_picture_is_matched_where_it_went():
    generator = torch.Generator().manual_seed(3)
    wide = torch.nn.functional.interpolate(torch.rand(1, 3, 24, 26, generator=generator), scale_factor=4.0)
    images = torch.cat([wide[..., :88], wide[..., 8:96]])  # what is at x is at x - 8 in the second
    cells = grid_points((96, 88), 2)
    known = describe_points(images, 2)
    found = match_points(known[0] @ known[1].mT, cells, cells, cells, num_columns=44, radius=20.0)
    moved = found.pixel - cells[found.source]
    inside = (cells[found.source, 0] > 24) & (cells[found.source, 0] < 70)
    assert int(inside.sum()) > 500
    assert torch.allclose(moved[inside].median(0).values, torch.tensor([-8.0, 0.0]), atol=0.3)
    assert float((moved[inside] - torch.tensor([-8.0, 0.0])).norm(dim=-1).lt(1.0).float().mean()) > 0.9
