"""Activations, conventions and the published handling of colours."""

from typing import Any

import torch
from torch import Tensor

from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.testing.oracle import assert_matches, hashed
from anystyle.types import Attributes, Cameras, Geometry
from anystyle_backbones.anysplat.adapter import Adapter
from tests.support.oracle import golden

GOLDEN = golden("anystyle_golden")


def adapter(**options: Any) -> Adapter:
    published = {"sh_degree": 4, "sh_mode": "reference", "pixel_center": 0.0, "scale_unit": 0.001, "scale_max": 0.3}
    return Adapter(**(published | {"fuse": False, "voxel_size": 0.05} | options))


def plane(depth: Tensor) -> Geometry:
    batch, views, height, width = depth.shape
    pose = torch.eye(4).expand(batch, views, 4, 4)
    intrinsics = torch.tensor([[50.0, 0, width / 2], [0, 50.0, height / 2], [0, 0, 1]]).expand(batch, views, 3, 3)
    return Geometry(Cameras(pose, intrinsics, (height, width)), depth, torch.ones_like(depth))


def attributes(raw: Tensor, coefficients: int) -> Attributes:
    """Attributes of one view of one row from [scale, quaternion, colours] of each pixel."""
    pixels = raw[:, None, None]
    return Attributes(
        opacity=torch.zeros_like(pixels[..., 0]),
        scale=pixels[..., :3],
        rotation=pixels[..., 3:7],
        color=pixels[..., 7:].unflatten(-1, (3, coefficients)),
        confidence=torch.zeros_like(pixels[..., 0]),
    )


def test_activations_are_the_published_ones() -> None:
    record = GOLDEN["adapter_sh4"]
    gaussians = adapter()(attributes(hashed(1030, (1, 4, 82), -3, 3), 25), plane(torch.ones(1, 1, 1, 4)), None)
    torch.testing.assert_close(gaussians.scales, torch.tensor(record["scales"]))
    torch.testing.assert_close(gaussians.rotations.roll(-1, -1), torch.tensor(record["rotations_xyzw"]))
    assert_matches(gaussians.harmonics.mT, record["harmonics"])
    rotation = matrix_from_wxyz(gaussians.rotations)
    covariances = rotation @ torch.diag_embed(gaussians.scales**2) @ rotation.mT
    torch.testing.assert_close(covariances, torch.tensor(record["covariances"]), rtol=1e-4, atol=1e-12)


def test_a_lone_constant_coefficient_is_spread_as_published() -> None:
    record = GOLDEN["adapter_style_sh0_quirk"]
    raw = attributes(hashed(1031, (1, 4, 10), -3, 3), 1)
    gaussians = adapter()(raw, plane(torch.ones(1, 1, 1, 4)), None)
    assert list(gaussians.harmonics.mT.shape) == record["harmonics_shape"]
    torch.testing.assert_close(gaussians.harmonics[0, 0, :, 0], torch.tensor(record["harmonics_g0_r"]))
    alone = adapter(sh_mode="dc_only")(raw, plane(torch.ones(1, 1, 1, 4)), None)
    assert torch.equal(alone.harmonics, raw.color[0, 0, 0].mT[None])


def test_the_spread_coefficient_is_a_gain_of_the_direction() -> None:
    record = GOLDEN["sh_quirk"]
    harmonics = adapter().harmonics(torch.ones(1, 1, 3, 1))[0, 0, :, 0]
    torch.testing.assert_close(torch.tensor(record["bases"]) @ harmonics, torch.tensor(record["effective_basis"]))


def test_scales_are_clamped_as_published() -> None:
    record = GOLDEN["adapter_scale_clamp"]
    raw = torch.zeros(1, 1, 10)
    raw[..., :3] = torch.tensor(record["raw_scales"])
    gaussians = adapter()(attributes(raw, 1), plane(torch.ones(1, 1, 1, 1)), None)
    torch.testing.assert_close(gaussians.scales[0, 0], torch.tensor(record["scales"]))


def fused_case() -> tuple[Attributes, Geometry]:
    shape = (2, 2, 4, 6)
    raw = Attributes(
        opacity=hashed(1, shape, -2, 2),
        scale=hashed(2, (*shape, 3), -2, 2),
        rotation=hashed(3, (*shape, 4), -1, 1),
        color=hashed(4, (*shape, 3, 4), -1, 1),
        confidence=hashed(5, shape, -2, 2),
    )
    depth = hashed(6, shape, 0.9, 1.1)
    depth[1, :, :2] = 1.0  # the second scene has fewer Gaussians
    return raw, plane(depth)


def test_attributes_are_fused_before_they_are_activated() -> None:
    raw, geometry = fused_case()
    module = adapter(fuse=True, sh_degree=1)
    clusters = module.cluster(geometry, raw)
    assert clusters is not None
    gaussians = module(raw, geometry, clusters)
    for scene in range(2):
        for rank in range(int(clusters.valid[scene].sum())):
            inside = clusters.index[scene] == rank
            share = clusters.weight[scene, inside]
            opacity = (share @ raw.opacity[scene].flatten()[inside]).sigmoid()
            scale = 0.001 * torch.nn.functional.softplus(share @ raw.scale[scene].flatten(0, 2)[inside])
            torch.testing.assert_close(gaussians.opacities[scene, rank], opacity)
            torch.testing.assert_close(gaussians.scales[scene, rank], scale)
    padding = ~clusters.valid
    assert padding.any() and not gaussians.opacities[padding].any()
    assert torch.equal(gaussians.rotations[padding], torch.tensor([[1.0, 0, 0, 0]]).expand(int(padding.sum()), 4))


def test_every_pixel_is_a_gaussian_without_fusion() -> None:
    raw, geometry = fused_case()
    module = adapter(sh_degree=1, pixel_center=0.5)
    assert module.cluster(geometry, raw) is None
    gaussians = module(raw, geometry, None)
    torch.testing.assert_close(gaussians.means, geometry.points(0.5).flatten(1, 3))
    assert gaussians.means.shape == (2, 2 * 4 * 6, 3)
