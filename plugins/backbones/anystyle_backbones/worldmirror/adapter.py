"""From raw attributes to Gaussians: activations, then fusion of pixels in voxels."""

import torch
from jaxtyping import Float, Int
from torch import Tensor

from anystyle import contracts
from anystyle.types import Attributes, Clusters, Gaussians, Geometry
from anystyle_backbones.anysplat.adapter import clusters_of, fuse, summed


class Adapter(contracts.Adapter):
    """Activates pixels' Gaussians, and averages those of a voxel by their weights.

    A fused quaternion is the normalised average, of signs as they are. With ``footprints`` scales are in sides of what
    the pixel covers at its Gaussian's depth, otherwise in world units.
    """

    def __init__(self, *, fuse: bool, voxel_size: float, scale_max: float, footprints: bool = False) -> None:
        super().__init__()
        self.fuse, self.voxel_size, self.scale_max, self.footprints = fuse, voxel_size, scale_max, footprints

    def cluster(self, geometry: Geometry, attributes: Attributes) -> Clusters | None:
        """Pixels that share a voxel become one Gaussian; voxels begin at the multiples of their size."""
        if not self.fuse:
            return None
        assert attributes.confidence is not None
        points = geometry.points().flatten(1, 3)
        weight = attributes.confidence.flatten(1).to(points.dtype).sigmoid()

        def shares(index: Int[Tensor, "B M"], size: int) -> Float[Tensor, "B M"]:
            return weight / summed(weight, index, size).clamp_min(1e-8)

        return clusters_of(points, (points.detach() / self.voxel_size).floor(), shares)

    def forward(self, attributes: Attributes, geometry: Geometry, clusters: Clusters | None) -> Gaussians:
        """Activate the attributes and fuse them with the weights decided before."""
        attributes = attributes.to(geometry.depth.dtype)

        def gather(values: Float[Tensor, "B V H W C"]) -> Float[Tensor, "B N C"]:
            flat = values.flatten(1, 3)
            return flat if clusters is None else fuse(flat, clusters)

        rotation, scale = attributes.rotation, attributes.scale.exp()
        if self.footprints:
            focal = geometry.cameras.intrinsics.diagonal(dim1=-2, dim2=-1)[..., :2]
            scale = scale * (geometry.depth.abs() * (1 / focal).mean(-1)[:, :, None, None])[..., None]
        rotations = gather(rotation / (rotation.norm(dim=-1, keepdim=True) + 1e-8))
        if clusters is not None:
            rotations = rotations / rotations.norm(dim=-1, keepdim=True).clamp_min(1e-8)
            identity = rotations.new_tensor([1.0, 0.0, 0.0, 0.0])
            rotations = torch.where(clusters.valid[..., None], rotations, identity)
        return Gaussians(
            means=geometry.points().flatten(1, 3) if clusters is None else clusters.means,
            rotations=rotations,
            scales=gather(scale.clamp_max(self.scale_max)),
            opacities=gather(attributes.opacity.sigmoid()[..., None])[..., 0],
            harmonics=gather(attributes.color.flatten(4))[:, :, None],
        )
