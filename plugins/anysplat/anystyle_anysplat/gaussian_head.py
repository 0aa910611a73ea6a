"""One raw Gaussian a pixel, from tokens and straight from the colours."""

from collections.abc import Sequence
from dataclasses import replace

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.dpt import Dpt, by_views
from anystyle.types import Attributes, Features, Inject, Site, Tokens, untouched


class GaussianHead(contracts.GaussianHead):
    """A DPT whose decoded map is joined by features of the image itself.

    The channels of the result: opacity (1), scale (3), quaternion xyzw (4), harmonics (3 K, colour-major), and the
    confidence (1) that weighs pixels where they are fused.

    Args:
        dim: Channels of the tokens.
        features: Channels of the decoder.
        channels: Channels of the levels.
        hidden: Channels of the last hidden layer.
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
        hidden: int,
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
        self.dpt = Dpt(dim=dim, features=features, channels=channels, hidden=hidden, outputs=9 + 3 * self.coefficients)
        self.direct = nn.Conv2d(3, self.direct_dim, 7, padding=3)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/tokens/0..3``, patch tokens of the styled levels, normalised; ``head/direct``, features of pixels.

        With ``styled_color`` also ``head/color``, the raw colours of pixels, of all views at once.
        """
        tokens = tuple(Site(_site(level), self.dim) for level in self.styled_levels)
        direct = (Site("head/direct", self.direct_dim),) if self.styled_direct else ()
        color = (Site("head/color", 3 * self.coefficients),) if self.styled_color else ()
        return (*tokens, *direct, *color)

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        """Predict raw attributes; quaternions are xyzw."""
        batch, views = images.shape[:2]
        raw = by_views(lambda some: self._raw(features, images, inject, some), views, max(1, self.chunk // batch))
        color = raw[..., 8:-1]
        if self.styled_color:
            size = (images.shape[-2], images.shape[-1])
            color = inject("head/color", Tokens(color.flatten(2, 3), grid=size)).data.unflatten(2, size)
        return Attributes(
            opacity=raw[..., 0],
            scale=raw[..., 1:4],
            rotation=raw[..., 4:8],
            color=color.unflatten(-1, (3, self.coefficients)),
            confidence=raw[..., -1],
        )

    def _raw(
        self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject, views: slice
    ) -> Float[Tensor, "B v H W F"]:
        images = images[:, views].to(self.direct.weight.dtype)
        batch, count, _, height, width = images.shape
        levels = []
        for level, layer in enumerate(self.taps):
            tokens = features[layer]
            patches = self.dpt.norm(tokens.patches[:, views].to(self.dpt.dtype))
            if level in self.styled_levels:
                patches = inject(_site(level), replace(tokens, data=patches, special=0)).data
            levels.append(patches.flatten(0, 1))
        decoded = self.dpt.decode(levels, features[self.taps[0]].grid, (height, width))
        # Channels lie side by side, so that pixels as tokens are a view: nothing is copied, with or without style.
        pixels = images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        direct = F.relu_(self.direct(pixels)).movedim(1, -1).flatten(1, 2).unflatten(0, (batch, count))
        if self.styled_direct:
            direct = inject("head/direct", Tokens(direct, grid=(height, width))).data
        direct = direct.flatten(0, 1).unflatten(1, (height, width)).movedim(-1, 1)
        return self.dpt.predict_(decoded.add_(direct)).unflatten(0, (batch, count))


def _site(level: int) -> str:
    return f"head/tokens/{level}"
