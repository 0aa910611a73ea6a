"""From raw attributes to Gaussians: fusion of pixels in voxels, then activations."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle import contracts
from anystyle.geometry.harmonics import damping
from anystyle.geometry.transforms import wxyz_from_xyzw
from anystyle.types import Attributes, Clusters, Gaussians, Geometry
from anystyle_anysplat.clusters import fuse, voxel_clusters


class Adapter(contracts.Adapter):
    """Fuses the pixels of a voxel by their confidence, ahead of any activation, as published.

    Harmonics of degree d > 0 are damped by ``0.1 * 0.25 ** d``. With ``sh_mode=reference`` a lone constant coefficient
    is also spread over all coefficients by these factors, a side effect of the published code that its weights were
    trained with: a fixed gain of 0.94 to 1.11 that depends on the direction. With ``dc_only`` it stays alone.
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
        self.sh_degree, self.sh_mode, self.pixel_center = sh_degree, sh_mode, pixel_center
        self.fuse, self.voxel_size = fuse, voxel_size
        self.scale_unit, self.scale_max = scale_unit, scale_max

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Pixels that share a voxel become one Gaussian."""
        if not self.fuse:
            return None
        assert attributes.confidence is not None
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
        factors = color.new_tensor(damping(self.sh_degree))
        coefficients = color.shape[-1]
        spread = self.sh_mode == "reference" and coefficients == 1
        return (color * (factors if spread else factors[:coefficients])).mT

    def _points(self, geometry: Geometry) -> Float[Tensor, "B M 3"]:
        with torch.autocast(geometry.depth.device.type, enabled=False):
            return geometry.points(self.pixel_center).flatten(1, 3)

    def _gather(self, values: Float[Tensor, "B V H W C"], clusters: Clusters | None) -> Float[Tensor, "B N C"]:
        flat = values.flatten(1, 3).float()
        return flat if clusters is None else fuse(flat, clusters)
