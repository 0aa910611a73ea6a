"""From Gaussians in space to Gaussians in an image: EWA splatting as in 3DGS and gsplat."""

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.geometry.transforms import matrix_from_wxyz
from anystyle.types import Value

MIN_ALPHA = 1 / 255
"""A Gaussian is not seen where it covers less than this share of a pixel."""

FRUSTUM_MARGIN = 0.15
"""How far outside of the image, in image widths, the local affine approximation may be taken."""

_LEAST = 1e-12
"""Of the share that is left of the area of a Gaussian: at 0 its root has no gradient."""


@dataclass(frozen=True)
class ProjectedGaussians(Value):
    """Gaussians as one image shows them, nearest first.

    Args:
        index: Which Gaussian each is.
        means: Image positions in pixels.
        conics: Inverse covariances ``xx, xy, yy`` in 1/pixels².
        opacities: In [0, 1], as the image shows them.
        radii: Half extents in pixels, along x and y, of where it covers at least :data:`MIN_ALPHA`.
        depths: Distances along the camera's z axis.
    """

    index: Int[Tensor, " n"]
    means: Float[Tensor, "n 2"]
    conics: Float[Tensor, "n 3"]
    opacities: Float[Tensor, " n"]
    radii: Float[Tensor, "n 2"]
    depths: Float[Tensor, " n"]


def covariances(rotations: Float[Tensor, "*batch 4"], scales: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3 3"]:
    """Covariances ``R S Sᵀ Rᵀ`` of Gaussians with quaternions wxyz of any norm and standard deviations."""
    axes = matrix_from_wxyz(rotations) * scales[..., None, :]  # ... 3 3
    return axes @ axes.mT


def project(
    means: Float[Tensor, "N 3"],
    covariances: Float[Tensor, "N 3 3"],
    opacities: Float[Tensor, " N"],
    camera_from_world: Float[Tensor, "4 4"],
    intrinsics: Float[Tensor, "3 3"],
    size: tuple[int, int],
    *,
    near: float,
    far: float,
    eps2d: float,
    antialiased: bool = False,
) -> ProjectedGaussians:
    """Project the Gaussians between ``near`` and ``far`` that an image shows, differentiable in all tensors.

    Means and covariances are in world space; ``size`` is height and width in pixels. ``eps2d`` is added to the
    variances in the image, in pixels²: the low-pass filter of a pixel, which ``antialiased`` opacities are lowered by.
    """
    rotation, translation = camera_from_world[:3, :3], camera_from_world[:3, 3]
    local = means @ rotation.T + translation  # N 3, camera axes
    index = ((local[:, 2] >= near) & (local[:, 2] <= far) & (opacities >= MIN_ALPHA)).nonzero().squeeze(1)
    # Everything is selected before it is divided: a Gaussian that is not seen must have a gradient of 0 and not nan.
    local, opacity = local[index], opacities[index]
    depth = local[:, 2]
    focal, center = intrinsics.diagonal()[:2], intrinsics[:2, 2]  # 2, 2
    slope = local[:, :2] / depth[:, None]  # n 2
    position = focal * slope + center  # n 2

    extent = intrinsics.new_tensor([size[1], size[0]])
    low = -(center / focal + FRUSTUM_MARGIN * extent / focal)
    high = (extent - center) / focal + FRUSTUM_MARGIN * extent / focal
    bounded = slope.clamp(low, high)  # n 2
    # The Jacobian of the projection times the camera's rotation: rows of n 2 3.
    jacobian = (focal / depth[:, None])[..., None] * (rotation[:2] - bounded[..., None] * rotation[2])
    blur = eps2d * torch.eye(2, dtype=means.dtype, device=means.device)
    sharp = jacobian @ covariances[index] @ jacobian.mT  # n 2 2
    covariance = sharp + blur

    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    determinant = xx * yy - xy * xy  # n
    if antialiased:
        share = (sharp[:, 0, 0] * sharp[:, 1, 1] - sharp[:, 0, 1].square()) / determinant
        opacity = opacity * share.clamp_min(_LEAST).sqrt()
    radii = (2 * (opacity / MIN_ALPHA).log()[:, None] * torch.stack([xx, yy], -1)).detach().sqrt().ceil()  # n 2
    seen = ((position + radii > 0) & (position - radii < extent)).all(-1)
    seen &= (determinant > 0) & determinant.isfinite() & (opacity >= MIN_ALPHA)
    kept = seen.nonzero().squeeze(1)
    kept = kept[depth[kept].argsort(stable=True)]
    conics = torch.stack([yy[kept], -xy[kept], xx[kept]], dim=-1) / determinant[kept, None]
    return ProjectedGaussians(index[kept], position[kept], conics, opacity[kept], radii[kept], depth[kept])
