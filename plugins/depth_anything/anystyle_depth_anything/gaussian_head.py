"""One raw Gaussian a pixel, from tokens and straight from the colours."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.dpt import Dpt, by_views
from anystyle.nn.pixels import normalised
from anystyle.types import Attributes, Features, Inject, Site, Tokens, untouched
from anystyle_depth_anything.geometry_head import HIDDEN


class GaussianHead(contracts.GaussianHead):
    """A decoder without a norm ahead of it, whose decoded map is joined by features of the image itself.

    The channels of the result: offset of the pixel (2), scale (3), quaternion (4), harmonics (3 K, colour-major),
    offset of the depth (1), opacity (1).

    Options are explained at :class:`~anystyle_depth_anything.DepthAnything`.
    """

    def __init__(
        self, *, dim: int, features: int, channels: Sequence[int], sh_degree: int, taps: Sequence[int], chunk: int
    ) -> None:
        super().__init__()
        self.dim, self.direct_dim = dim, features // 2
        self.coefficients = (sh_degree + 1) ** 2
        self.taps = tuple(taps)
        self.chunk = chunk
        self.dpt = Dpt(
            dim=dim,
            features=features,
            channels=channels,
            hidden=HIDDEN,
            outputs=11 + 3 * self.coefficients,
            normed=False,
            rectified=False,
        )
        widths = (3, features // 8, features // 4, features // 2)
        layers = [(nn.Conv2d(a, b, 3, padding=1), nn.GELU()) for a, b in pairwise(widths)]
        self.direct = nn.Sequential(*(module for pair in layers for module in pair))

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/tokens/0..3``, patch tokens of the levels; ``head/direct``, features of every pixel."""
        tokens = tuple(Site(_site(level), self.dim) for level in range(len(self.taps)))
        return (*tokens, Site("head/direct", self.direct_dim))

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        batch, views = images.shape[:2]
        raw = by_views(lambda chosen: self._raw(features, images, inject, chosen), views, max(1, self.chunk // batch))
        return Attributes(
            opacity=raw[..., -1],
            scale=raw[..., 2:5],
            rotation=raw[..., 5:9],
            color=raw[..., 9:-2].unflatten(-1, (3, self.coefficients)),
            offset=torch.cat([raw[..., :2], raw[..., -2:-1]], dim=-1),
        )

    def _raw(
        self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject, views: slice
    ) -> Float[Tensor, "B v H W F"]:
        images = normalised(images[:, views].to(self.dpt.dtype))
        batch, count, _, height, width = images.shape
        levels = []
        for level, layer in enumerate(self.taps):
            tokens = features[layer]
            patches = tokens.patches[:, views].to(self.dpt.dtype)
            patches = inject(_site(level), replace(tokens, data=patches, special=0)).data
            levels.append(patches.flatten(0, 1))
        decoded = self.dpt.decode(levels, features[self.taps[0]].grid, (height, width))
        direct = self.direct(images.flatten(0, 1)).flatten(2).mT.unflatten(0, (batch, count))
        direct = inject("head/direct", Tokens(direct, grid=(height, width))).data
        direct = direct.flatten(0, 1).mT.unflatten(2, (height, width))
        return self.dpt.predict_(decoded + direct).unflatten(0, (batch, count))


def _site(level: int) -> str:
    return f"head/tokens/{level}"
