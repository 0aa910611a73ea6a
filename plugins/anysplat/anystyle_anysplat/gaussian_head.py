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

    Options are explained at :class:`~anystyle_anysplat.AnySplat`.
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
        chunk: int,
    ) -> None:
        super().__init__()
        self.dim, self.direct_dim = dim, features // 2
        self.coefficients = (sh_degree + 1) ** 2
        self.taps = tuple(taps)
        self.chunk = chunk
        self.dpt = Dpt(dim=dim, features=features, channels=channels, hidden=hidden, outputs=9 + 3 * self.coefficients)
        self.direct = nn.Conv2d(3, self.direct_dim, 7, padding=3)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``head/tokens/0..3``, normalised patch tokens of the levels; ``head/direct``, features of pixels."""
        tokens = tuple(Site(_site(level), self.dim) for level in range(len(self.taps)))
        return (*tokens, Site("head/direct", self.direct_dim))

    def forward(self, features: Features, images: Float[Tensor, "B V 3 H W"], inject: Inject = untouched) -> Attributes:
        """Predict raw attributes; quaternions are xyzw."""
        batch, views = images.shape[:2]
        raw = by_views(lambda chosen: self._raw(features, images, inject, chosen), views, max(1, self.chunk // batch))
        return Attributes(
            opacity=raw[..., 0],
            scale=raw[..., 1:4],
            rotation=raw[..., 4:8],
            color=raw[..., 8:-1].unflatten(-1, (3, self.coefficients)),
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
            patches = inject(_site(level), replace(tokens, data=patches, special=0)).data
            levels.append(patches.flatten(0, 1))
        decoded = self.dpt.decode(levels, features[self.taps[0]].grid, (height, width))
        # Channels lie side by side, so that pixels as tokens are a view: nothing is copied, with or without style.
        pixels = images.flatten(0, 1).contiguous(memory_format=torch.channels_last)
        direct = F.relu_(self.direct(pixels)).movedim(1, -1).flatten(1, 2).unflatten(0, (batch, count))
        direct = inject("head/direct", Tokens(direct, grid=(height, width))).data
        direct = direct.flatten(0, 1).unflatten(1, (height, width)).movedim(-1, 1)
        return self.dpt.predict_(decoded.add_(direct)).unflatten(0, (batch, count))


def _site(level: int) -> str:
    return f"head/tokens/{level}"
