"""The adapter's options and units in closed form; the goldens of the whole network have the published ones alone."""

import pytest
import torch
import torch.nn.functional as F

from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_xyzw
from anystyle.testing.oracle import hashed
from anystyle.types import Attributes, Cameras, Geometry
from anystyle_backbones.depth_anything.adapter import Adapter
from anystyle_backbones.depth_anything.heads import decode_pose

SIZE = (6, 8)


def some_cameras() -> Cameras:
    encoding = hashed(50, (1, 2, 9), -1, 1)
    encoding[..., 7:] = 0.9 + 0.1 * encoding[..., 7:]
    return decode_pose(encoding, SIZE)


def test_a_field_of_view_of_nothing_has_a_finite_focal_length() -> None:
    cameras = decode_pose(F.pad(torch.tensor([[[0.0, 0, 0, 0, 0, 0, 1]]]), (0, 2)), SIZE)
    assert cameras.intrinsics[0, 0, 1, 1].item() == pytest.approx(3 / 1e-6)


def raw(cameras: Cameras) -> tuple[Attributes, Geometry]:
    shape = (1, 2, *cameras.size)
    attributes = Attributes(
        opacity=hashed(1, shape, -2, 2),
        scale=hashed(2, (*shape, 3), -2, 2),
        rotation=hashed(3, (*shape, 4), -1, 1),
        color=hashed(4, (*shape, 3, 9), -1, 1),
        offset=torch.zeros(*shape, 3),
    )
    return attributes, Geometry(cameras, hashed(5, shape, 1, 3), torch.ones(shape))


def adapter(depth_along: str = "ray", rotations: str = "published") -> Adapter:
    return Adapter(depth_along=depth_along, rotations=rotations, scale_min=1e-5, scale_max=30.0)


Case = tuple[Attributes, Geometry]


@pytest.fixture
def case() -> Case:
    return raw(some_cameras())


class TestAdapter:
    def test_depth_along_z_is_the_framework_s_own(self, case: Case) -> None:
        attributes, geometry = case
        means = adapter("z")(attributes, geometry, None).means
        torch.testing.assert_close(means, geometry.points().flatten(1, 3), rtol=1e-4, atol=1e-5)

    def test_depth_along_the_ray_is_the_distance_from_the_camera(self, case: Case) -> None:
        attributes, geometry = case
        means = adapter()(attributes, geometry, None).means.unflatten(1, (2, *SIZE))
        origin = geometry.cameras.world_from_camera[:, :, None, None, :3, 3]
        torch.testing.assert_close((means - origin).norm(dim=-1), geometry.depth, rtol=1e-4, atol=1e-5)

    def test_offsets_are_in_pixels_and_in_units_of_depth(self, case: Case) -> None:
        attributes, geometry = case
        assert attributes.offset is not None
        attributes.offset[...] = torch.tensor([1.0, 0.0, 0.5])
        means = adapter("z")(attributes, geometry, None).means.unflatten(1, (2, *SIZE))
        deeper = Geometry(geometry.cameras, geometry.depth.roll(1, dims=-1) + 0.5, geometry.confidence)
        deeper.depth[..., 1:] = geometry.depth[..., :-1] + 0.5
        torch.testing.assert_close(means[..., :-1, :], deeper.points()[..., 1:, :], rtol=1e-4, atol=1e-5)

    def test_behind_the_camera_scales_are_their_absolutes(self, case: Case) -> None:
        attributes, geometry = case
        front = adapter()(attributes, geometry, None).scales
        behind = adapter()(attributes, Geometry(geometry.cameras, -geometry.depth, geometry.confidence), None).scales
        assert front.min() > 0 and torch.equal(front, behind)

    def test_scales_are_in_tenths_of_two_pixels(self, case: Case) -> None:
        attributes, geometry = case
        attributes.scale[...] = -100.0
        lens = geometry.cameras.intrinsics
        unit = 0.1 * geometry.depth * (1 / lens[..., 0, 0] + 1 / lens[..., 1, 1])[..., None, None]
        scales = adapter()(attributes, geometry, None).scales.unflatten(1, (2, *SIZE))
        torch.testing.assert_close(scales, 1e-5 * unit[..., None].expand_as(scales))

    def test_quaternions_in_the_camera_s_axes_turn_with_it(self, case: Case) -> None:
        attributes, geometry = case
        found = matrix_from_wxyz(adapter(rotations="camera")(attributes, geometry, None).rotations)
        own = matrix_from_wxyz(wxyz_from_xyzw(attributes.rotation))
        pose = geometry.cameras.world_from_camera[:, :, None, None, :3, :3]
        torch.testing.assert_close(found, (pose @ own).flatten(1, 3), rtol=1e-4, atol=1e-5)

    def test_both_ways_agree_for_a_camera_that_is_not_turned(self) -> None:
        cameras = some_cameras()
        cameras.world_from_camera[...] = torch.eye(4)
        attributes, geometry = raw(cameras)
        one, other = (adapter(rotations=way)(attributes, geometry, None) for way in ("published", "camera"))
        torch.testing.assert_close(matrix_from_wxyz(one.rotations), matrix_from_wxyz(other.rotations))
        assert (one.rotations[..., 3] >= 0).all()
