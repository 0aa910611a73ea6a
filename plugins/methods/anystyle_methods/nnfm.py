"""NNFM: match every feature of a render to its nearest of the style image."""

from collections.abc import Sequence
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float, Int
from torch import Tensor

from anystyle.losses.features import FeatureFn, FeatureLoss, mean_where, style_images
from anystyle.types import Stylization


class NNFM(FeatureLoss):
    """Bring every feature of a render near its nearest of the style image (ARF, Zhang et al. 2022, equation 3).

    ``mean_i min_j (1 - cos(F_i, F_j^style))`` on the channels of all ``layers`` together, averaged over views whose
    style has an image. ARF reads VGG-16; the default layers are the same block of VGG-19.

    Args:
        layers: Layers of one resolution.
        weight: Weight in the objective; 1 in ARF, 5 in StylizedGS, 10 or 100 in G-Style.

    Example:
        >>> from dataclasses import replace
        >>> from anystyle.testing.inputs import stylization
        >>> from anystyle.types import Style
        >>> red, green = torch.eye(3)[:2, :, None, None]
        >>> result = stylization()
        >>> renders = replace(result.renders, color=red.expand_as(result.renders.color))
        >>> style = Style(image=green.expand(1, 3, 16, 16))
        >>> NNFM(network="texture", layers=("rgb",), size=16)(replace(result, renders=renders, style=style))
        tensor(1.)
    """

    def __init__(
        self,
        *,
        network: str = "vgg19",
        layers: Sequence[str] = ("relu3_1", "relu3_2", "relu3_3"),
        size: int | None = 224,
        weight: float = 1.0,
    ) -> None:
        super().__init__(network, layers, size, weight)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"network": "texture", "layers": ("relu3_1", "relu3_2"), "size": 48}

    def compare(self, result: Stylization, images: Float[Tensor, "M 3 H W"], features: FeatureFn) -> Float[Tensor, ""]:
        styles = style_images(result)
        if styles is None:
            return images.new_zeros(())
        image, given = styles
        num_views = len(images) // len(image)
        targets = _unit(self.targets(image)).repeat_interleave(num_views, 0)
        return mean_where(
            self.distances(_unit(features()), targets, rows=len(image)), given.repeat_interleave(num_views)
        )

    def distances(
        self, features: Float[Tensor, "M C S"], targets: Float[Tensor, "M C T"], *, rows: int
    ) -> Float[Tensor, " M"]:
        """Of each view of ``rows`` scenes."""
        return torch.stack([self.distance(*pair) for pair in zip(features, targets, strict=True)])

    def distance(self, features: Float[Tensor, "C S"], target: Float[Tensor, "C T"]) -> Float[Tensor, ""]:
        """Of a view's unit features from the style image's."""
        return (1 - (features * target[:, _nearest(features, target)]).sum(0)).mean()


def _unit(features: list[Float[Tensor, "M _ h w"]]) -> Float[Tensor, "M C S"]:
    return F.normalize(torch.cat(features, dim=1).flatten(2), dim=1, eps=1e-8)


@torch.no_grad()
def _nearest(features: Float[Tensor, "C S"], target: Float[Tensor, "C T"]) -> Int[Tensor, " S"]:
    # In chunks: all similarities of two 448 pixel images at once would be 0.6 GB.
    return torch.cat([(chunk.mT @ target).argmax(-1) for chunk in features.split(4096, dim=1)])
