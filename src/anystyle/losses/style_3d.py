"""Style in 3D: match the statistics of features fused over views."""

from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.losses._features import FeatureLoss, mean_where, style_images
from anystyle.types import Geometry, Stylization


class Style3D(FeatureLoss):
    """Match mean and deviation of features fused in voxels (Stylos, 3D style loss).

    Features of all rendered views are carried to the world points of their pixels, fused in voxels with a softmax of
    the backbone's confidence, and their statistics over the voxels compared with the style image's:
    ``sum_l w_l (mean_c (mu - mu_style)^2 + mean_c (sigma - sigma_style)^2)`` with the ``w_l`` scaled to sum to 1. A
    surface that several views see counts once. A layer's voxels are larger by the ratio of the image's side to its own.

    The points are those of the predicted geometry of the input views, so the renders must be of these views.

    Args:
        layer_weights: Weight of each layer.
        voxel_size: At the image's resolution, in the scene's units.
        size: Side that the style image is resized to; ``None`` keeps it as it is.
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1", "relu5_1"),
        layer_weights: Sequence[float] = (256.0, 64.0, 16.0, 4.0, 1.0),
        voxel_size: float = 0.002,
        size: int | None = None,
        weight: float = 1.0,
    ) -> None:
        if len(layer_weights) != len(layers):
            raise UserError(
                f"there are {len(layers)} layers and {len(layer_weights)} layer_weights; give one weight a layer"
            )
        super().__init__(network, layers, size, weight)
        self.layer_weights = tuple(value / sum(layer_weights) for value in layer_weights)
        self.voxel_size = voxel_size

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"network": "texture", "layers": ("relu1_1", "relu2_1"), "layer_weights": (2.0, 1.0)}

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        styles = style_images(result)
        color = result.renders.color
        if styles is None:
            return color.new_zeros(())
        image, given = styles
        with torch.no_grad():
            targets = self.features(image)
        rendered = self.network(color.flatten(0, 1), self.layers)
        total = color.new_zeros(())
        for layer_weight, target, maps in zip(self.layer_weights, targets, rendered, strict=True):
            fused = self._fuse(maps.unflatten(0, color.shape[:2]), result.scene.geometry)
            pairs = zip(fused, target, strict=True)
            distances = torch.stack([_distance(voxels, style.flatten(1)) for voxels, style in pairs])
            total = total + layer_weight * mean_where(distances, given)
        return total

    def _fuse(self, maps: Float[Tensor, "B V C h w"], geometry: Geometry) -> list[Float[Tensor, "C _"]]:
        size = maps.shape[-2:]
        world = _resized(geometry.points().movedim(-1, 2), size, "nearest-exact")
        confidence = _resized(geometry.confidence[:, :, None], size, "bilinear")
        height, width = geometry.depth.shape[-2:]
        side = self.voxel_size * (height * width / (size[0] * size[1])) ** 0.5
        return [
            fuse_in_voxels(
                features.movedim(1, 0).flatten(1), points.movedim(1, 0).flatten(1).mT, weights.flatten(), side
            )
            for features, points, weights in zip(maps, world, confidence, strict=True)
        ]


def fuse_in_voxels(
    features: Float[Tensor, "C S"], points: Float[Tensor, "S 3"], confidence: Float[Tensor, " S"], side: float
) -> Float[Tensor, "C _"]:
    """Mean feature of every occupied voxel of side ``side``, weighted by the softmax of confidence within it."""
    voxels, index = (points / side).round().long().unique(dim=0, return_inverse=True)
    count = voxels.shape[0]
    peak = confidence.new_full((count,), -torch.inf).scatter_reduce(0, index, confidence, "amax")
    weight = (confidence - peak[index]).exp()
    weight = weight / weight.new_zeros(count).index_add(0, index, weight)[index]
    return features.new_zeros(features.shape[0], count).index_add(1, index, features * weight)


def _distance(first: Tensor, second: Tensor) -> Tensor:
    (mean, std), (mean_style, std_style) = _moments(first), _moments(second)
    return F.mse_loss(mean, mean_style) + F.mse_loss(std, std_style)


def _moments(features: Float[Tensor, "C S"]) -> tuple[Float[Tensor, " C"], Float[Tensor, " C"]]:
    # The published epsilon is inside the root. A single voxel has no variance.
    correction = 1 if features.shape[1] > 1 else 0
    return features.mean(1), (features.var(1, correction=correction) + 1e-5).sqrt()


def _resized(maps: Float[Tensor, "B V C H W"], size: torch.Size, mode: str) -> Float[Tensor, "B V C h w"]:
    if maps.shape[-2:] == size:
        return maps
    options = {"align_corners": False} if mode == "bilinear" else {}
    return F.interpolate(maps.flatten(0, 1), size=tuple(size), mode=mode, **options).unflatten(0, maps.shape[:2])
