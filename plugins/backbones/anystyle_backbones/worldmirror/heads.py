"""What is read off the tokens: cameras, two depths, and raw Gaussians that start from the photograph's colours."""

from collections.abc import Sequence
from dataclasses import replace

from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.geometry.harmonics import CONSTANT
from anystyle.types import Attributes, Features, Geometry, Inject, untouched
from anystyle_backbones import heads
from anystyle_backbones.anysplat import heads as anysplat
from anystyle_backbones.dpt import Dpt


class GeometryHead(heads.GeometryHead, contracts.GeometryHead):
    """Cameras, depth, and the point of each pixel's Gaussian, by a depth of its own along the ray of its corner.

    ``placing`` predicts the logarithm of that depth, and of confidence less one, which nothing reads. Published is one
    decoder for that depth and the Gaussians' attributes; here each has one, for geometry is never styled.
    """

    def __init__(
        self, camera: heads.CameraRegressor, depth: Dpt, placing: Dpt, *, taps: Sequence[int], chunk: int
    ) -> None:
        super().__init__(camera, depth, taps=taps, chunk=chunk)
        self.placing = placing

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"]) -> Geometry:
        geometry = super().forward(features, images)
        depth = self.decoded(self.placing, features, images)[..., 0].exp()
        return replace(geometry, pointmap=replace(geometry, depth=depth).points(pixel_center=0.0))


class GaussianHead(anysplat.GaussianHead, contracts.GaussianHead):
    """AnySplat's Gaussian head with other channels: colours are what is added to the photograph's.

    The channels of the result: quaternion wxyz (4), scale (3), opacity (1), colour (3), and the weight (1) of pixels
    where they are fused. A fused pixel's opacity is its weight, as published, and the channel of opacity is not read.
    """

    def __init__(self, dpt: Dpt, direct: nn.Module, *, taps: Sequence[int], chunk: int, fused: bool) -> None:
        super().__init__(dpt, direct, sh_degree=0, taps=taps, chunk=chunk)
        self.fused = fused

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        attributes = super().forward(features, images, inject)
        constant = (images.movedim(2, -1) - 0.5) / CONSTANT
        return replace(attributes, color=attributes.color + constant[..., None].to(attributes.color.dtype))

    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        return Attributes(
            opacity=raw[..., -1 if self.fused else 7],
            scale=raw[..., 4:7],
            rotation=raw[..., :4],
            color=raw[..., 8:11, None],
            confidence=raw[..., -1],
        )
