"""From raw attributes to Gaussians: fusion of pixels in voxels, then activations."""

import math
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle import contracts
from anystyle.geometry.harmonics import damping
from anystyle.geometry.transforms import wxyz_from_xyzw
from anystyle.nn.tokens import constant
from anystyle.types import Attributes, Clusters, Gaussians, Geometry


class Adapter(contracts.Adapter):
    """Fuses the pixels of a voxel by their confidence, ahead of any activation, as published.

    Harmonics of degree d > 0 are damped by ``0.1 * 0.25 ** d``. With ``sh_mode=reference`` a lone constant coefficient
    is also spread over all coefficients by these factors, a side effect of the published code that its weights were
    trained with: a fixed gain of 0.94 to 1.11 that depends on the direction. ``dc_only`` uses only the constant one.
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
        parts = [attributes.opacity[..., None], attributes.scale, attributes.rotation, attributes.color.flatten(4)]
        raw = [part.flatten(1, 3).float() for part in parts]
        opacity, scale, rotation, color = raw if clusters is None else [fuse(part, clusters) for part in raw]
        color = color.unflatten(-1, (3, -1))
        opacities = opacity[..., 0].sigmoid()
        rotations = wxyz_from_xyzw(rotation / (rotation.norm(dim=-1, keepdim=True) + 1e-8))
        if clusters is not None:
            opacities = opacities * clusters.valid
            identity = constant((1.0, 0.0, 0.0, 0.0), rotations.device, rotations.dtype)
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
        factors = constant(tuple(damping(self.sh_degree)), color.device, color.dtype)
        coefficients = color.shape[-1]
        spread = self.sh_mode == "reference" and coefficients == 1
        return (color * (factors if spread else factors[:coefficients])).mT

    def _points(self, geometry: Geometry) -> Float[Tensor, "B M 3"]:
        with torch.autocast(geometry.depth.device.type, enabled=False):
            return geometry.points(self.pixel_center).flatten(1, 3)


def voxel_clusters(points: Float[Tensor, "B M 3"], confidence: Float[Tensor, "B M"], voxel_size: float) -> Clusters:
    """Cluster world points by voxel, each weighted by the softmax of the confidences (logits) in its voxel.

    Voxels lie around the multiples of ``voxel_size`` (ties to even) and are numbered in lexicographic order. A point's
    weight is ``exp(c - max c) / (sum exp(c - max c) + 1e-6)`` over its voxel, and the voxel's mean the weighted sum.
    Differentiable in the points and confidences. Scenes are padded to one count; padding has mean 0 and no points.
    """
    if not math.isfinite(points.detach().abs().amax()):
        raise ValueError("points to fuse are infinite or not a number; the predicted depth or cameras have diverged")
    index = torch.stack([lexicographic_ranks(scene) for scene in (points.detach() / voxel_size).round().long()])
    counts = index.amax(dim=1) + 1
    size = int(counts.max())
    valid = torch.arange(size, device=points.device) < counts[:, None]
    weight = _softmax(confidence, index, size)
    unfused = Clusters(index=index, weight=weight, means=points.new_zeros(len(points), size, 3), valid=valid)
    return Clusters(index=index, weight=weight, means=fuse(points, unfused), valid=valid)


def fuse(values: Float[Tensor, "B M C"], clusters: Clusters) -> Float[Tensor, "B N C"]:
    """The weighted sum of the values of each cluster's points; padding gets 0. Linear in ``values``."""
    batch, _, channels = values.shape
    size = clusters.means.shape[1]
    weighted = values * clusters.weight[..., None].to(values.dtype)
    flat = _flat_index(clusters.index, size)[:, None].expand(-1, channels)
    total = values.new_zeros(batch * size, channels).scatter_add_(0, flat, weighted.flatten(0, 1))
    return total.unflatten(0, (batch, size))


def lexicographic_ranks(cells: Int[Tensor, "M 3"]) -> Int[Tensor, " M"]:
    """The rank of each row among the distinct rows in lexicographic order."""
    lowest = cells.amin(dim=0)
    spans = (cells.amax(dim=0) - lowest + 1).tolist()
    if math.prod(spans) < 2**63:
        x, y, z = (cells - lowest).unbind(-1)
        return torch.unique((x * spans[1] + y) * spans[2] + z, return_inverse=True)[1]
    return torch.unique(cells, dim=0, return_inverse=True)[1]  # slower, but so wide a range has no room in one integer


def _softmax(logits: Float[Tensor, "B M"], index: Int[Tensor, "B M"], size: int) -> Float[Tensor, "B M"]:
    flat, values = _flat_index(index, size), logits.flatten()
    count = len(logits) * size
    largest = values.new_full((count,), -torch.inf).scatter_reduce(0, flat, values.detach(), "amax")
    exponentials = (values - largest[flat]).exp()
    total = exponentials.new_zeros(count).scatter_add_(0, flat, exponentials)
    return (exponentials / (total[flat] + 1e-6)).view_as(logits)


def _flat_index(index: Int[Tensor, "B M"], size: int) -> Int[Tensor, " BM"]:
    scenes = range(0, size * len(index), size)
    return torch.cat([one + first for one, first in zip(index, scenes, strict=True)]) if len(index) > 1 else index[0]
