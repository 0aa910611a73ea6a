"""One raw Gaussian a pixel, from tokens and from the image's colours."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.dpt import Dpt
from anystyle.nn.heads import DptGaussians
from anystyle.types import Attributes


class GaussianHead(DptGaussians, contracts.GaussianHead):
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
        outputs = 9 + 3 * (sh_degree + 1) ** 2
        dpt = Dpt(dim=dim, features=features, channels=channels, hidden=hidden, outputs=outputs)
        super().__init__(dpt, dim=dim, direct_dim=features // 2, sh_degree=sh_degree, taps=taps, chunk=chunk)
        self.direct = nn.Conv2d(3, self.direct_dim, 7, padding=3)

    def image_features(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        # Channels lie side by side, so that pixels as tokens are a view: nothing is copied, with or without style.
        features = self.direct(images.contiguous(memory_format=torch.channels_last))
        return F.relu_(features).movedim(1, -1).flatten(1, 2)

    def attributes(self, raw: Float[Tensor, "B V H W F"]) -> Attributes:
        return Attributes(
            opacity=raw[..., 0],
            scale=raw[..., 1:4],
            rotation=raw[..., 4:8],
            color=raw[..., 8:-1].unflatten(-1, (3, self.coefficients)),
            confidence=raw[..., -1],
        )
