"""The projection of Gaussians against the derivative of the pinhole camera."""

import torch
from torch import Tensor

from anystyle.geometry.projection import FRUSTUM_MARGIN, MIN_ALPHA, ProjectedGaussians, covariances, project
from tests.support.scenes import cameras, gaussians

SIZE = (30, 40)


def projected(distance: float) -> tuple[ProjectedGaussians, Tensor, Tensor, Tensor, Tensor]:
    """Splats; and of the Gaussians they are of: places in camera axes, covariances there, opacities; intrinsics."""
    scene, views = gaussians(1, 300, dtype=torch.float64), cameras(1, 1, SIZE, distance=distance, dtype=torch.float64)
    shapes = covariances(scene.rotations[0], scene.scales[0])
    pose, intrinsics = views.camera_from_world[0, 0], views.intrinsics[0, 0]
    limits = {"near": 0.05, "far": 100.0, "eps2d": 0.3}
    splats = project(scene.means[0], shapes, scene.opacities[0], pose, intrinsics, SIZE, **limits)
    local = scene.means[0, splats.index] @ pose[:3, :3].T + pose[:3, 3]
    rotation = pose[:3, :3]
    return splats, local, rotation @ shapes[splats.index] @ rotation.T, scene.opacities[0, splats.index], intrinsics


def pinhole(point: Tensor, intrinsics: Tensor) -> Tensor:
    return (intrinsics @ (point / point[2]))[:2]


def linear_conic(point: Tensor, shape: Tensor, intrinsics: Tensor) -> Tensor:
    """The inverse of a covariance that goes through the Jacobian of the pinhole camera at a point."""
    jacobian = torch.autograd.functional.jacobian(lambda p: pinhole(p, intrinsics), point)
    inverse = torch.linalg.inv(jacobian @ shape @ jacobian.T + 0.3 * torch.eye(2, dtype=torch.float64))
    return torch.stack([inverse[0, 0], inverse[0, 1], inverse[1, 1]])


def test_splats_are_the_linear_image() -> None:
    """In the frustum, the covariance goes through the Jacobian of the pinhole camera at the centre."""
    splats, local, shapes, _, intrinsics = projected(distance=3.0)
    assert len(splats.index) > 200 and (splats.depths.diff() >= 0).all()
    torch.testing.assert_close(splats.depths, local[:, 2])
    torch.testing.assert_close(splats.means, torch.stack([pinhole(point, intrinsics) for point in local]))
    for conic, point, shape in zip(splats.conics, local, shapes, strict=True):
        torch.testing.assert_close(conic, linear_conic(point, shape, intrinsics))


def test_outside_of_the_frustum_the_slope_is_bounded() -> None:
    splats, local, shapes, _, intrinsics = projected(distance=0.6)
    extent = torch.tensor([SIZE[1], SIZE[0]], dtype=torch.float64)
    focal, center = intrinsics.diagonal()[:2], intrinsics[:2, 2]
    low = (-FRUSTUM_MARGIN * extent - center) / focal
    high = ((1 + FRUSTUM_MARGIN) * extent - center) / focal
    slope = local[:, :2] / local[:, 2:]
    bounded = slope.clamp(low, high)
    outside = (bounded != slope).any(-1)
    assert 5 < outside.sum() < len(outside)
    for i in outside.nonzero()[:, 0]:
        point = torch.cat([bounded[i], torch.ones(1, dtype=torch.float64)]) * local[i, 2]
        torch.testing.assert_close(splats.conics[i], linear_conic(point, shapes[i], intrinsics))


def test_radii_hold_all_that_is_seen() -> None:
    """On the border of the box, and so outside of it, alpha is below the least that is shown."""
    splats, *_, opacities, _ = projected(distance=3.0)
    angle = torch.linspace(0, 2 * torch.pi, 721, dtype=torch.float64)
    ray = torch.stack([angle.cos(), angle.sin()], dim=-1)  # 721 2
    reach = (splats.radii[:, None] / ray.abs().clamp_min(1e-12)).amin(-1, keepdim=True)  # n 721 1
    dx, dy = (reach * ray).unbind(-1)  # n 721
    xx, xy, yy = splats.conics[:, :, None].unbind(1)
    alpha = opacities[:, None] * torch.exp(-0.5 * (xx * dx * dx + yy * dy * dy) - xy * dx * dy)
    assert alpha.max() < MIN_ALPHA
