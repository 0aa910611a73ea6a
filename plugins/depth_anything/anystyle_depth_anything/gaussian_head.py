"""One raw Gaussian a pixel, from tokens and from the image's colours."""

from collections.abc import Sequence
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.dpt import Dpt
from anystyle.nn.heads import DptGaussians
from anystyle.nn.tokens import normalised
from anystyle.types import Attributes
from anystyle_depth_anything.geometry_head import HIDDEN


class GaussianHead(DptGaussians, contracts.GaussianHead):
    """A decoder without a norm ahead of it, whose decoded map is joined by features of the image itself.

    The channels of the result: offset of the pixel (2), scale (3), quaternion (4), harmonics (3 K, colour-major),
    offset of the depth (1), opacity (1).

    Options are explained at :class:`~anystyle_depth_anything.DepthAnything`.
    """

    def __init__(
        self, *, dim: int, features: int, channels: Sequence[int], sh_degree: int, taps: Sequence[int], chunk: int
    ) -> None:
        dpt = Dpt(
            dim=dim,
            features=features,
            channels=channels,
            hidden=HIDDEN,
            outputs=11 + 3 * (sh_degree + 1) ** 2,
            normed=False,
            rectified=False,
        )
        super().__init__(dpt, dim=dim, direct_dim=features // 2, sh_degree=sh_degree, taps=taps, chunk=chunk)
        widths = (3, features // 8, features // 4, features // 2)
        layers = [(nn.Conv2d(a, b, 3, padding=1), nn.GELU()) for a, b in pairwise(widths)]
        self.direct = nn.Sequential(*(module for pair in layers for module in pair))

    def image_features(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        return self.direct(normalised(images)).flatten(2).mT

    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        return Attributes(
            opacity=raw[..., -1],
            scale=raw[..., 2:5],
            rotation=raw[..., 5:9],
            color=raw[..., 9:-2].unflatten(-1, (3, self.coefficients)),
            offset=torch.cat([raw[..., :2], raw[..., -2:-1]], dim=-1),
        )
