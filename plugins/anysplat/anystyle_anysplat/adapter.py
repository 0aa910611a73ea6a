"""From raw attributes to Gaussians: fusion of pixels in voxels, then activations."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.geometry.clusters import fuse, voxel_clusters
from anystyle.geometry.rotations import wxyz_from_xyzw
from anystyle.types import Attributes, Clusters, Gaussians, Geometry


class Adapter(contracts.Adapter):
    """Fuses the pixels of a voxel by their confidence, ahead of any activation, as published.

    Args:
        sh_degree: Of the backbone's harmonics.
        sh_mode: ``reference``: harmonics of degree d > 0 are damped by ``0.1 * 0.25 ** d``, and a lone constant
            coefficient is spread over all coefficients by the same factors, a side effect of the published code that
            its weights were trained with: a fixed gain of 0.94 to 1.11 that depends on the direction. ``dc_only``:
            damped alike, but a lone constant coefficient stays alone.
        pixel_center: Where in its pixel a point is seen; the published weights were trained with 0.
        fuse: Whether pixels are fused; otherwise each is a Gaussian.
        voxel_size: Side of a voxel, in world units.
        scale_unit: World units of scale a unit of softplus.
        scale_max: Largest scale, in world units.
    """

    def __init__(
        self,
        *,
        sh_degree: int,
        sh_mode: Literal["reference", "dc_only"],
        pixel_center: float,
        fuse: bool,
        voxel_size: float,
        scale_unit: float,
        scale_max: float,
    ) -> None:
        super().__init__()
        self.sh_degree = sh_degree
        self.sh_mode = sh_mode
        self.pixel_center = pixel_center
        self.fuse = fuse
        self.voxel_size = voxel_size
        self.scale_unit, self.scale_max = scale_unit, scale_max

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Pixels that share a voxel become one Gaussian."""
        if not self.fuse:
            return None
        if attributes.confidence is None:
            raise ValueError("the attributes have no confidence to weigh pixels with; set fuse=false")
        points = self._points(geometry)
        return voxel_clusters(points, attributes.confidence.flatten(1).to(points.dtype), self.voxel_size)

    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Fuse the attributes with the weights decided before, and activate them."""
        opacity = self._gather(attributes.opacity[..., None], clusters)[..., 0]
        scale = self._gather(attributes.scale, clusters)
        rotation = self._gather(attributes.rotation, clusters)
        coefficients = attributes.color.shape[-1]
        color = self._gather(attributes.color.flatten(4), clusters).unflatten(-1, (3, coefficients))
        opacities = opacity.sigmoid()
        rotations = wxyz_from_xyzw(rotation / (rotation.norm(dim=-1, keepdim=True) + 1e-8))
        if clusters is not None:
            opacities = opacities * clusters.valid
            identity = rotations.new_tensor([1.0, 0.0, 0.0, 0.0])
            rotations = torch.where(clusters.valid[..., None], rotations, identity)
        return Gaussians(
            means=self._points(geometry) if clusters is None else clusters.means,
            rotations=rotations,
            scales=(self.scale_unit * F.softplus(scale)).clamp_max(self.scale_max),
            opacities=opacities,
            harmonics=self.harmonics(color),
        )

    def harmonics(self, color: Float[Tensor, "B N 3 K"]) -> Float[Tensor, "B N L 3"]:
        """Damped coefficients, coefficient-major; see ``sh_mode``."""
        damping = color.new_tensor(sh_damping(self.sh_degree))
        coefficients = color.shape[-1]
        spread = self.sh_mode == "reference" and coefficients == 1
        return (color * (damping if spread else damping[:coefficients])).mT

    def _points(self, geometry: Geometry) -> Float[Tensor, "B M 3"]:
        with torch.autocast(geometry.depth.device.type, enabled=False):
            return geometry.points(self.pixel_center).flatten(1, 3)

    def _gather(self, values: Float[Tensor, "B V H W C"], clusters: Clusters | None) -> Float[Tensor, "B N C"]:
        flat = values.flatten(1, 3).float()
        return flat if clusters is None else fuse(flat, clusters)


def sh_damping(degree: int) -> list[float]:
    """A factor for each coefficient up to ``degree``: 1, and ``0.1 * 0.25 ** d`` for degree d > 0."""
    return [1.0] + [0.1 * 0.25**d for d in range(1, degree + 1) for _ in range(2 * d + 1)]
