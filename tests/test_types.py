from dataclasses import replace

import torch
from scipy.spatial.transform import Rotation

from anystyle.types import Attributes, Cameras, Geometry, Scene, StyleEmbedding, Tokens, Views


def cameras(batch=2, views=3, size=(6, 8)):
    pose = torch.eye(4, dtype=torch.float64).repeat(batch, views, 1, 1)
    pose[..., :3, :3] = torch.tensor(Rotation.random(batch * views, rng=0).as_matrix()).unflatten(0, (batch, views))
    pose[..., :3, 3] = torch.randn(batch, views, 3, dtype=torch.float64)
    lens = torch.tensor([[7.0, 0, 4.2], [0, 7.5, 2.9], [0, 0, 1]], dtype=torch.float64)
    return Cameras(pose.float(), lens.float().expand(batch, views, 3, 3), size)


def test_the_inverse_pose_is_the_inverse_matrix_under_autocast_too():
    given = cameras()
    expected = torch.linalg.inv(given.world_from_camera)
    torch.testing.assert_close(given.camera_from_world, expected, rtol=1e-5, atol=1e-5)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        torch.testing.assert_close(given.camera_from_world, expected, rtol=1e-5, atol=1e-5)


def test_points_project_back_to_their_pixels():
    given = cameras()
    depth = torch.rand(2, 3, 6, 8) + 0.5
    with torch.autocast("cpu", dtype=torch.bfloat16):
        points = Geometry(given, depth, depth).points(pixel_center=0.5)
    local = torch.einsum("bvij,bvhwj->bvhwi", given.camera_from_world[..., :3, :3], points)
    local = local + given.camera_from_world[..., None, None, :3, 3]
    torch.testing.assert_close(local[..., 2], depth, rtol=1e-5, atol=1e-5)
    pixel = torch.einsum("bvij,bvhwj->bvhwi", given.intrinsics, local)
    x = torch.arange(8) + 0.5
    y = torch.arange(6)[:, None] + 0.5
    torch.testing.assert_close(pixel[..., 0] / pixel[..., 2], x.expand(2, 3, 6, 8), rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(pixel[..., 1] / pixel[..., 2], y.expand(2, 3, 6, 8), rtol=1e-4, atol=1e-4)


def test_values_are_pytrees_that_can_be_seen_as_batches():
    views = Views(torch.rand(1, 3, 3, 6, 8), cameras(batch=1), names=("a", "b", "c"))
    many = views.expand(4)
    assert many.images.shape[0] == 4 and many.cameras is not None and many.cameras.intrinsics.shape[0] == 4
    assert many.images.data_ptr() == views.images.data_ptr() and many.names == views.names
    assert views.to(torch.float64).images.dtype == torch.float64
    assert views.select([2, 0]).names == ("c", "a")


def test_unstyled_attributes_are_the_same_tensors():
    def attributes():
        return Attributes(*(torch.rand(1, 2, 4, 4, *shape) for shape in ((), (3,), (4,), (3, 9))))

    base, styled = attributes(), attributes()
    mixed = base.with_(styled, ("color", "rotation"))
    assert mixed.color is styled.color and mixed.rotation is styled.rotation
    assert mixed.opacity is base.opacity and mixed.scale is base.scale and base.with_degree(1).color.shape[-1] == 4


def test_the_ends_of_a_way_between_styles_are_the_styles():
    first, second = (StyleEmbedding(torch.randn(2, 8), torch.randn(2, 8)) for _ in range(2))
    assert torch.equal(first.toward(second, 0.0).vector, first.vector)
    assert torch.equal(first.toward(second, 1.0).direction, second.direction)
    middle = first.toward(second, torch.tensor([0.5, 0.25]))
    torch.testing.assert_close(middle.vector[1], 0.75 * first.vector[1] + 0.25 * second.vector[1])


def test_joined_scenes_hold_what_each_held():
    """Values inside values, mappings and fields that are absent."""

    def scene(fill):
        data = torch.full((1, 2, 4, 3), fill)
        tokens = Tokens(data, grid=(2, 2))
        pixels = torch.full((1, 2, 6, 8), fill)
        attributes = Attributes(pixels, *(data.new_zeros(1, 2, 6, 8, *shape) for shape in ((3,), (4,), (3, 1))))
        views = Views(torch.full((1, 2, 3, 6, 8), fill), names=("a", "b"))
        return Scene(views, tokens, {4: tokens}, Geometry(cameras(1, 2), pixels, pixels), attributes, None)

    both = Scene.cat([scene(1.0), scene(2.0)])
    assert both.batch == 2 and both.clusters is None and both.views.names == ("a", "b") and both.stem.grid == (2, 2)
    for row, expected in enumerate((1.0, 2.0)):
        assert torch.equal(both.features[4].data[row], torch.full((2, 4, 3), expected))
        assert torch.equal(both.geometry.depth[row], torch.full((2, 6, 8), expected))


def test_a_point_map_moves_with_its_cameras_as_depth_does():
    """Points that lie on their pixels' rays go where unprojected depth goes; others keep their pixel."""
    generator = torch.Generator().manual_seed(0)
    # The rotations have the digits of float32.
    four = cameras(1, 4).to(torch.float64)
    one, other = four.select([0, 1]), four.select([2, 3])
    other = replace(other, intrinsics=other.intrinsics * torch.tensor([[1.2], [0.9], [1.0]]).double())
    depth = 1 + torch.rand(1, 2, 6, 8, generator=generator, dtype=torch.float64)
    plain = Geometry(one, depth, torch.ones_like(depth))
    mapped = replace(plain, pointmap=plain.points())
    torch.testing.assert_close(mapped.seen_from(one).points(), mapped.points(), rtol=1e-5, atol=1e-6)
    expected = plain.seen_from(other).points()
    torch.testing.assert_close(mapped.seen_from(other).points(), expected, rtol=1e-5, atol=1e-6)
    off = replace(plain, pointmap=mapped.points() + 0.05 * torch.randn(1, 2, 6, 8, 3, generator=generator).double())
    seen = [pixels(geometry) for geometry in (off, off.seen_from(other))]
    torch.testing.assert_close(seen[0], seen[1], rtol=1e-5, atol=1e-5)


def pixels(geometry):
    homogeneous = torch.nn.functional.pad(geometry.points(), (0, 1), value=1.0)
    pose, lens = geometry.cameras.camera_from_world, geometry.cameras.intrinsics
    seen = torch.einsum("bvij,bvhwj->bvhwi", lens @ pose[..., :3, :], homogeneous)
    return seen[..., :2] / seen[..., 2:]
