"""Losses that Stylos was trained with and no other network here: AdaIN's statistics, over voxels too, and variation."""

from collections.abc import Sequence
from typing import Literal

import torch
import torch.distributed as dist
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Loss
from anystyle.errors import UserError
from anystyle.losses.features import FeatureFn, FeatureLoss, style_images
from anystyle.ranges import Positive
from anystyle.types import Stylization
from anystyle_backbones.anysplat.adapter import fuse, voxel_clusters


class AdainVoxels(FeatureLoss):
    """Match means and deviations of features to the style's, and features to the photographs' (Stylos' objective).

    ``(content_weight * content + style) / (B V)``: of ``voxels`` and ``scene`` less the more views there are, as
    published. A layer's distance is ``mean_c (m - m')^2 + mean_c (s - s')^2``, with ``m`` and ``s`` mean and deviation
    of every channel.

    Args:
        pool: What statistics are taken over: an ``image``, whose distances are added up; all pixels of a ``scene``;
            or its ``voxels``, as released: features of pixels that share a voxel are averaged by their confidence.
        network: A network of :func:`anystyle.vision.networks.load`, or several to choose from.
        layers: Whose statistics are compared; content is compared at the last two.
        layer_weights: Weights of the layers, divided by their sum; ``image`` has none. Published: these for CO3D, and
            equal ones for DL3DV.
        content_weight: Weight of the mean squared difference to the photographs' features.
        voxel_size: Side of a voxel at full resolution, in world units; a layer of a tenth of the pixels of a side has
            voxels ten times as large.
        size: Side of the square that images are first resized to; ``None`` leaves renders as they are.
        weight: In the objective.

    Example:
        >>> result = inputs.stylization(number=1)
        >>> loss = AdainVoxels(pool="scene", network="texture", layers=("relu1_1", "relu2_1"), content_weight=0.0)
        >>> own = replace(result, style=Style(result.renders.color[:, 0]))  # a render in its own style
        >>> print(f"{loss(own):.2f}")
        0.00
    """

    def __init__(
        self,
        *,
        pool: Literal["image", "scene", "voxels"] = "voxels",
        network: str = "vgg_normalised",
        layers: Sequence[str] = ("relu1_1", "relu2_1", "relu3_1", "relu4_1", "relu5_1"),
        layer_weights: Sequence[float] = (16, 8, 4, 2, 1),
        content_weight: float = 0.1,
        voxel_size: Positive = 0.002,
        size: int | None = None,
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, weight)
        if len(layers) > len(layer_weights) or len(layers) < 2:
            raise UserError(f"{len(layers)} layers and {len(layer_weights)} weights; give at least two, a weight each")
        self.pool, self.content_weight, self.voxel_size = pool, content_weight, voxel_size
        chosen = layer_weights[: len(layers)]
        self.layer_weights = [1.0] * len(layers) if pool == "image" else [one / sum(chosen) for one in chosen]

    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        style, content = self.terms(result, features())
        return (self.content_weight * content + style) / len(images)

    def terms(
        self, result: Stylization, features: Sequence[Float[Tensor, "M _ _ _"]]
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """The style's term and the content's, neither weighted nor divided; no style without an image."""
        batch, views = result.renders.color.shape[:2]
        photographs = self.targets(result.views.images)
        errors = [F.mse_loss(one, other) for one, other in zip(features[-2:], photographs[-2:], strict=True)]
        # Terms that are means already are divided by the number of rows once more: of the rows of all processes.
        world = dist.get_world_size() if dist.is_available() and dist.is_initialized() else 1
        content = torch.stack(errors).sum() * (batch * views if self.pool == "image" else 0.5 / world)
        styles, style = style_images(result), features[0].new_zeros(())
        if styles is None:
            return style, content
        painting = F.interpolate(styles[0], result.views.size, mode="bilinear", antialias=True)
        scale = 1 / (batch * world) if self.pool == "scene" else 1.0
        for weight, of_layer, wanted in zip(self.layer_weights, features, self.targets(painting), strict=True):
            rows = of_layer.unflatten(0, (batch, views))
            for row in styles[1].nonzero().flatten().tolist():
                for pooled in self._pooled(result, row, rows[row]):
                    style = style + scale * weight * _distance(pooled, wanted[row].flatten(1))
        return style, content

    def _pooled(
        self, result: Stylization, row: int, features: Float[Tensor, "V C h w"]
    ) -> Sequence[Float[Tensor, "C _"]]:
        """What statistics are taken over, of one scene."""
        if self.pool == "image":
            return features.flatten(2).unbind()
        flat = features.movedim(1, 0).flatten(1)  # C Vhw
        if self.pool == "scene":
            return (flat,)
        attributes, (height, width) = result.scene.attributes, features.shape[-2:]
        points = result.scene.geometry.points(0.0)[row].movedim(-1, 1).detach()  # V 3 H W
        logits = attributes.opacity if attributes.confidence is None else attributes.confidence
        side = self.voxel_size * (points[0, 0].numel() / (height * width)) ** 0.5
        points = F.interpolate(points, (height, width), mode="nearest-exact").movedim(1, -1).flatten(0, 2)
        confidence = F.interpolate(logits[row].detach()[:, None], (height, width), mode="bilinear").flatten()
        return (fuse(flat.mT[None], voxel_clusters(points[None], confidence[None], side))[0].mT,)


def _distance(one: Float[Tensor, "C n"], other: Float[Tensor, "C m"]) -> Float[Tensor, ""]:
    (mean, deviation), (mean_wanted, deviation_wanted) = (
        (x.mean(-1), (x.var(-1, correction=min(1, x.shape[-1] - 1)) + 1e-5).sqrt()) for x in (one, other)
    )
    return F.mse_loss(mean, mean_wanted) + F.mse_loss(deviation, deviation_wanted)


class DiagonalVariation(Loss):
    """Prefer smooth renders: squared differences of neighbours in four directions, as in Stylos.

    ``2/3 (mean dx^2 + mean dy^2) + 1/6 (mean of squares along both diagonals)``, with the borders repeated once.

    Args:
        weight: In the objective.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> result = stylization()
        >>> grey = replace(result.renders, color=torch.full_like(result.renders.color, 0.5))
        >>> DiagonalVariation()(replace(result, renders=grey))
        tensor(0.)
    """

    def __init__(self, *, weight: float = 10.0) -> None:
        super().__init__()
        self.weight = weight

    def forward(self, result: Stylization) -> Float[Tensor, ""]:
        color = result.renders.color.flatten(0, 1)
        straight = sum(color.diff(dim=axis).square().sum() for axis in (-1, -2)) / color.numel()
        padded = F.pad(color, (1, 1, 1, 1), mode="replicate")
        falling = (padded[..., 1:, 1:] - padded[..., :-1, :-1]).square().mean()
        rising = (padded[..., 1:, :-1] - padded[..., :-1, 1:]).square().mean()
        return 2 / 3 * straight + (falling + rising) / 6
