"""Long captures in groups."""

import itertools
from dataclasses import replace

import pytest
import torch

from anystyle.geometry import harmonics
from anystyle.geometry.transforms import Similarity, matrix_from_wxyz
from anystyle.pipeline.encode import Group, cameras_of, encode_groups, split, with_cameras
from anystyle.testing.toy.backbone import ToyBackbone
from anystyle.types import Geometry, Scene, Views
from tests.support.scenes import gaussians


def views(count):
    return Views(torch.rand(1, count, 3, 16, 16, generator=torch.Generator().manual_seed(0)))


def change(scale=1.7):
    turn = matrix_from_wxyz(torch.nn.functional.normalize(torch.tensor([0.9, 0.1, -0.3, 0.2]), dim=0))
    return Similarity(torch.tensor(scale), turn, torch.tensor([0.3, -0.2, 0.5]))


@pytest.mark.parametrize(
    ("count", "size", "overlap"), [(3, 4, 1), (4, 4, 2), (9, 4, 1), (10, 4, 2), (11, 5, 4), (7, 2, 1)]
)
def test_groups_cover_every_view_and_share_some(count, size, overlap):
    groups = split(count, size, overlap)
    assert sorted({view for group in groups for view in group}) == list(range(count))
    assert all(len(group) == min(size, count) for group in groups)
    assert all(len(set(a) & set(b)) >= overlap for a, b in itertools.pairwise(groups))


@pytest.mark.parametrize(("size", "overlap"), [(1, 1), (4, 4), (4, 0)])
def test_groups_that_cannot_be(size, overlap):
    with pytest.raises(ValueError, match="groups of"):
        split(9, size, overlap)


def test_moved_gaussians_look_the_same_from_moved_directions():
    scene, where = gaussians(1, 6, 2), change()
    after = where.gaussians(scene)
    torch.testing.assert_close(after.means, where.scale * scene.means @ where.rotation.mT + where.translation)
    expected = where.rotation @ matrix_from_wxyz(scene.rotations)
    torch.testing.assert_close(matrix_from_wxyz(after.rotations), expected, atol=1e-5, rtol=1e-4)
    torch.testing.assert_close(after.scales, where.scale * scene.scales)
    direction = torch.nn.functional.normalize(torch.randn(1, 6, 3, generator=torch.Generator().manual_seed(1)), dim=-1)
    seen = harmonics.colors(scene.harmonics, direction)
    torch.testing.assert_close(
        harmonics.colors(after.harmonics, direction @ where.rotation.mT), seen, atol=1e-4, rtol=1e-4
    )


def test_one_group_is_the_single_pass_bit_for_bit():
    backbone = ToyBackbone().eval()
    with torch.no_grad():
        capture = encode_groups(backbone.encode, views(3), size=4)
        scene = backbone.encode(views(3))
        whole = capture[0].gaussians(lambda one: backbone.adapter(one.attributes, one.geometry, one.clusters))
        alone = backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
    assert torch.equal(whole.means, alone.means) and torch.equal(whole.harmonics, alone.harmonics)


def test_a_group_in_another_frame_and_unit_is_brought_back():
    """Two groups of one scene, the second as if it had been predicted in a frame and unit of its own."""
    backbone = ToyBackbone().eval()
    other = change()
    with torch.no_grad():
        whole = backbone.encode(views(6))
    starts = iter([0, 2])

    def encode(some):
        first = next(starts)
        own = slice(first, first + 4)
        geometry = Geometry(
            whole.geometry.cameras.select(own), whole.geometry.depth[:, own], whole.geometry.confidence[:, own]
        )
        if first:
            pose = other.poses(geometry.cameras.world_from_camera[0])[None]
            cameras = replace(geometry.cameras, world_from_camera=pose)
            geometry = replace(geometry, cameras=cameras, depth=geometry.depth * other.scale)
        attributes = whole.attributes.map(lambda tensor: tensor[:, own])
        return Scene(some, whole.stem, whole.features, geometry, attributes, None)

    capture = encode_groups(encode, views(6), size=4, overlap=2)
    assert [group.num_new for group in capture] == [4, 2]
    result, expected = capture[1].capture_from_group, other.inverse()
    assert result is not None
    torch.testing.assert_close(result.rotation, expected.rotation, atol=1e-5, rtol=0)
    torch.testing.assert_close(result.scale, expected.scale)
    brought, predicted = (cameras.world_from_camera for cameras in (cameras_of(capture), whole.cameras))
    torch.testing.assert_close(brought, predicted, atol=1e-4, rtol=1e-4)
    with torch.no_grad():
        counts = [
            group.gaussians(lambda one: backbone.adapter(one.attributes, one.geometry, None)).means.shape[1]
            for group in capture
        ]
    assert sum(counts) == 6 * 16 * 16


def test_known_cameras_come_back_in_their_own_frame():
    backbone = ToyBackbone().eval()
    with torch.no_grad():
        scene = backbone.encode(views(4))
        spread = scene.cameras.world_from_camera.clone()
        spread[0, :, :3, 3] += torch.arange(4.0)[:, None] * torch.tensor([0.1, 0.02, 0.0])
        moved_apart = replace(scene.cameras, world_from_camera=spread)
        groups = Group.whole(replace(scene, geometry=replace(scene.geometry, cameras=moved_apart)))
        known = replace(moved_apart, world_from_camera=change().poses(spread[0])[None])
        placed, way = with_cameras(groups, known, backbone.adapter)
    torch.testing.assert_close(cameras_of(placed).world_from_camera, spread, atol=1e-4, rtol=1e-3)
    torch.testing.assert_close(way.scale, 1 / change().scale, atol=1e-4, rtol=1e-4)
    with pytest.raises(ValueError, match="do not match the images"):
        with_cameras(groups, known.select([3, 2, 1, 0]), backbone.adapter)
