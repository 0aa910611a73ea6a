"""Where this network differs from others of its family, and closed forms of its parts."""

import math

import pytest
import torch
import torch.nn.functional as F
from torch import nn

from anystyle.geometry import harmonics as world_harmonics
from anystyle.geometry.transforms import matrix_from_wxyz, wxyz_from_xyzw
from anystyle.nn.attention import SwiGlu
from anystyle.nn.dpt import add_positions_
from anystyle.types import Attributes, Cameras, Geometry
from anystyle_depth_anything.adapter import Adapter, harmonics
from anystyle_depth_anything.heads import decode_pose
from anystyle_depth_anything.transformer import Embedder, flat_positions
from oracle import hashed

SIZE = (6, 8)


def some_cameras(seed: int = 50, views: int = 2) -> Cameras:
    encoding = hashed(seed, (1, views, 9), -1, 1)
    encoding[..., 7:] = 0.9 + 0.1 * encoding[..., 7:]
    return decode_pose(encoding, SIZE)


class TestPose:
    def test_encodings_are_of_world_from_camera_motions(self) -> None:
        encoding = torch.tensor([[[1.0, 2, 3, 0, 0, 0, 1, 2 * math.atan(0.5), 2 * math.atan(0.25)]]])
        cameras = decode_pose(encoding, SIZE)
        assert cameras.world_from_camera[0, 0, :3, 3].tolist() == [1, 2, 3]
        expected = [[16.0, 0, 4], [0, 6, 3], [0, 0, 1]]
        torch.testing.assert_close(cameras.intrinsics[0, 0], torch.tensor(expected))

    def test_a_field_of_view_of_nothing_has_a_finite_focal_length(self) -> None:
        cameras = decode_pose(F.pad(torch.tensor([[[0.0, 0, 0, 0, 0, 0, 1]]]), (0, 2)), SIZE)
        assert cameras.intrinsics[0, 0, 1, 1].item() == pytest.approx(3 / 1e-6)


class TestRope:
    def test_across_views_no_patch_has_a_place(self) -> None:
        positions = flat_positions((2, 3))
        assert positions[0].tolist() == [0, 0] and (positions[1:] == 1).all() and len(positions) == 7


def cubic(distance: torch.Tensor) -> torch.Tensor:
    """Keys' kernel with a slope of -0.75."""
    near = 1.25 * distance**3 - 2.25 * distance**2 + 1
    far = -0.75 * (distance**3 - 5 * distance**2 + 8 * distance - 4)
    return torch.where(distance <= 1, near, torch.where(distance < 2, far, 0.0))


class TestEmbedder:
    def embedder(self) -> Embedder:
        torch.manual_seed(0)
        return Embedder(
            dim=8,
            depth=1,
            heads=2,
            ffn="mlp",
            mlp_ratio=2.0,
            layer_scale=1.0,
            patch_size=2,
            grid=4,
            reference="middle",
        )

    def test_position_embeddings_are_used_as_they_are_on_their_own_grid_alone(self) -> None:
        embedder = self.embedder()
        assert embedder.positions((4, 4)) is embedder.pos_embed
        # As many patches on another grid are resampled, and a constant stays one.
        assert embedder.positions((2, 8)).shape == embedder.pos_embed.shape
        nn.init.constant_(embedder.pos_embed, 0.7)
        torch.testing.assert_close(embedder.positions((3, 7)), torch.full((1, 22, 8), 0.7))

    def test_resampling_adds_a_tenth_of_a_patch(self) -> None:
        embedder = self.embedder()
        row = hashed(2, (4,))
        with torch.no_grad():  # equal rows
            embedder.pos_embed[:, 1:] = row.repeat(4)[None, :, None]
        found = embedder.positions((4, 12))[0, 1:, 0].unflatten(0, (4, 12))[1]
        places = (torch.arange(12) + 0.5) * 4 / 12.1 - 0.5
        columns = torch.arange(-2, 6)
        weights = cubic((places[:, None] - columns).abs())
        torch.testing.assert_close(found, weights @ row[columns.clamp(0, 3)], rtol=1e-4, atol=1e-5)

    def test_the_reference_has_a_camera_token_of_its_own(self) -> None:
        embedder = self.embedder()
        stem = embedder(hashed(1, (2, 3, 3, 4, 6)))
        assert stem.special == 1 and stem.reference is not None and stem.reference.tolist() == [1, 1]
        own, shared = embedder.camera_token[0]
        torch.testing.assert_close(stem.data[:, :, 0], torch.stack([shared, own, shared]).expand(2, -1, -1))


class TestDecoder:
    def test_positions_are_those_of_the_corners_in_units_of_the_diagonal(self) -> None:
        added = add_positions_(torch.zeros(1, 8, 6, 8), 8 / 6)[0]
        column = 0.8 * 7 / 8
        torch.testing.assert_close(added[0, :, -1], torch.full((6,), 0.1 * math.sin(column)))
        torch.testing.assert_close(added[3, :, 0], torch.full((6,), 0.1 * math.cos(column / 10)))
        torch.testing.assert_close(added[4, 0, :], torch.full((8,), -0.1 * math.sin(0.6 * 5 / 6)))

    def test_gates_have_two_thirds_of_the_width(self) -> None:
        assert SwiGlu(1536, 4 * 1536).w12.weight.shape == (8192, 1536)
        layer = SwiGlu(8, 24)
        gate, value = layer.w12(torch.ones(8)).chunk(2)
        torch.testing.assert_close(layer(torch.ones(8)), layer.w3(gate * gate.sigmoid() * value))


def raw(cameras: Cameras, degree: int = 2) -> tuple[Attributes, Geometry]:
    views, (height, width) = cameras.intrinsics.shape[1], cameras.size
    shape = (1, views, height, width)
    attributes = Attributes(
        opacity=hashed(1, shape, -2, 2),
        scale=hashed(2, (*shape, 3), -2, 2),
        rotation=hashed(3, (*shape, 4), -1, 1),
        color=hashed(4, (*shape, 3, (degree + 1) ** 2), -1, 1),
        offset=torch.zeros(*shape, 3),
    )
    return attributes, Geometry(cameras, hashed(5, shape, 1, 3), torch.ones(shape))


def adapter(depth_along: str = "ray", rotations: str = "published") -> Adapter:
    return Adapter(depth_along=depth_along, rotations=rotations, scale_min=1e-5, scale_max=30.0)


class TestAdapter:
    def test_depth_along_z_is_the_framework_s_own(self) -> None:
        attributes, geometry = raw(some_cameras())
        means = adapter("z")(attributes, geometry, None).means
        torch.testing.assert_close(means, geometry.points().flatten(1, 3), rtol=1e-4, atol=1e-5)

    def test_depth_along_the_ray_is_the_distance_from_the_camera(self) -> None:
        attributes, geometry = raw(some_cameras())
        means = adapter()(attributes, geometry, None).means.unflatten(1, (2, *SIZE))
        origin = geometry.cameras.world_from_camera[:, :, None, None, :3, 3]
        torch.testing.assert_close((means - origin).norm(dim=-1), geometry.depth, rtol=1e-4, atol=1e-5)

    def test_offsets_are_in_pixels_and_in_units_of_depth(self) -> None:
        attributes, geometry = raw(some_cameras())
        assert attributes.offset is not None
        attributes.offset[...] = torch.tensor([1.0, 0.0, 0.5])
        means = adapter("z")(attributes, geometry, None).means.unflatten(1, (2, *SIZE))
        deeper = Geometry(geometry.cameras, geometry.depth.roll(1, dims=-1) + 0.5, geometry.confidence)
        deeper.depth[..., 1:] = geometry.depth[..., :-1] + 0.5
        torch.testing.assert_close(means[..., :-1, :], deeper.points()[..., 1:, :], rtol=1e-4, atol=1e-5)

    def test_behind_the_camera_scales_are_their_absolutes(self) -> None:
        attributes, geometry = raw(some_cameras())
        front = adapter()(attributes, geometry, None).scales
        behind = adapter()(attributes, Geometry(geometry.cameras, -geometry.depth, geometry.confidence), None).scales
        assert front.min() > 0 and torch.equal(front, behind)

    def test_scales_are_in_tenths_of_two_pixels(self) -> None:
        attributes, geometry = raw(some_cameras())
        attributes.scale[...] = -100.0
        lens = geometry.cameras.intrinsics
        unit = 0.1 * geometry.depth * (1 / lens[..., 0, 0] + 1 / lens[..., 1, 1])[..., None, None]
        scales = adapter()(attributes, geometry, None).scales.unflatten(1, (2, *SIZE))
        torch.testing.assert_close(scales, 1e-5 * unit[..., None].expand_as(scales))

    def test_quaternions_in_the_camera_s_axes_turn_with_it(self) -> None:
        attributes, geometry = raw(some_cameras())
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

    def test_harmonics_turn_as_those_of_the_world_do(self) -> None:
        cameras = some_cameras()
        attributes, _ = raw(cameras)
        found = harmonics(attributes.color, cameras)
        damped = attributes.color * torch.tensor([1.0] + [0.025] * 3 + [0.00625] * 5)
        for view in range(2):
            expected = world_harmonics.rotate(damped[:, view].mT, cameras.world_from_camera[0, view, :3, :3])
            torch.testing.assert_close(found[:, view], expected, rtol=1e-4, atol=1e-5)
