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
from anystyle_depth_anything.rays import HIDDEN


class GaussianHead(contracts.GaussianHead):
    """A decoder without a norm ahead of it, whose decoded map is joined by features of the image itself.

    The channels of the result: offset of the pixel (2), scale (3), quaternion (4), harmonics (3 K, colour-major),
    offset of the depth (1), opacity (1).

    Args:
        dim: Channels of the tokens.
        features: Channels of the decoder.
        channels: Channels of the levels.
        sh_degree: Of the harmonics.
        taps: The layers it reads, four, in rising order.
        styled_levels: Of the taps, by their order, those that are sites. A shift of all tokens of levels 0 and 1
            comes out of their transposed convolutions as a grid with the period of a patch, which is plain to see
            where patches are few (published: all).
        styled_direct: Whether features of pixels are a site (published: yes).
        styled_color: Whether the colours that come out are a site as well, all views at a time (published: no).
        chunk: Views decoded at a time, and so passed to ``inject`` at a time; a matter of memory alone.
    """

    def __init__(
        self,
        *,
        dim: int,
        features: int,
        channels: Sequence[int],
        sh_degree: int,
        taps: Sequence[int],
        styled_levels: Sequence[int] = (0, 1, 2, 3),
        styled_direct: bool = True,
        styled_color: bool = False,
        chunk: int,
    ) -> None:
        super().__init__()
        self.dim, self.direct_dim = dim, features // 2
        self.coefficients = (sh_degree + 1) ** 2
        self.taps = tuple(taps)
        self.styled_levels = tuple(styled_levels)
        self.styled_direct, self.styled_color = styled_direct, styled_color
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
        """``head/tokens/0..3``, patch tokens of the styled levels; ``head/direct``, features of every pixel.

        With ``styled_color`` also ``head/color``, the raw colours of pixels, of all views at once.
        """
        tokens = tuple(Site(_site(level), self.dim) for level in self.styled_levels)
        direct = (Site("head/direct", self.direct_dim),) if self.styled_direct else ()
        color = (Site("head/color", 3 * self.coefficients),) if self.styled_color else ()
        return (*tokens, *direct, *color)

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        """Predict raw attributes."""
        batch, views = images.shape[:2]
        raw = by_views(lambda some: self._raw(features, images, inject, some), views, max(1, self.chunk // batch))
        color = raw[..., 9:-2]
        if self.styled_color:
            size = (images.shape[-2], images.shape[-1])
            color = inject("head/color", Tokens(color.flatten(2, 3), grid=size)).data.unflatten(2, size)
        return Attributes(
            opacity=raw[..., -1],
            scale=raw[..., 2:5],
            rotation=raw[..., 5:9],
            color=color.unflatten(-1, (3, self.coefficients)),
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
            if level in self.styled_levels:
                patches = inject(_site(level), replace(tokens, data=patches, special=0)).data
            levels.append(patches.flatten(0, 1))
        decoded = self.dpt.decode(levels, features[self.taps[0]].grid, (height, width))
        direct = self.direct(images.flatten(0, 1)).flatten(2).mT.unflatten(0, (batch, count))
        if self.styled_direct:
            direct = inject("head/direct", Tokens(direct, grid=(height, width))).data
        direct = direct.flatten(0, 1).mT.unflatten(2, (height, width))
        return self.dpt.predict_(decoded + direct).unflatten(0, (batch, count))


def _site(level: int) -> str:
    return f"head/tokens/{level}"
