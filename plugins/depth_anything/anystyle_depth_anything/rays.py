"""The second chain of the dual decoder, which tells rays."""

from collections.abc import Sequence

import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.dpt import Chain, add_positions_

HIDDEN = 32
"""Channels of decoders' last hidden layers, in every size."""


class RayChain(nn.Module):
    """Tells the ray of every place on a grid eight times as fine as the patches."""

    def __init__(self, features: int) -> None:
        super().__init__()
        wide, narrow = features, features // 2
        self.fusions = Chain(wide, rectified=False)
        self.neck = nn.Sequential(
            *(nn.Conv2d(a, b, 3, padding=1) for a, b in [(wide, narrow), (narrow, wide)] * 2 + [(wide, narrow)])
        )
        self.first = nn.Conv2d(narrow, HIDDEN, 3, padding=1)
        self.norm = nn.LayerNorm(HIDDEN)
        self.last = nn.Conv2d(HIDDEN, 7, 1)

    def forward(self, maps: Sequence[Float[Tensor, "M C _ _"]]) -> Float[Tensor, "M 7 h w"]:
        """Direction and origin of rays, and the logarithm of confidence less one."""
        x = self.neck(self.fusions(maps))
        x = self.first(add_positions_(x, x.shape[-1] / x.shape[-2]))
        return self.last(F.relu(self.norm(x.movedim(1, -1)).movedim(-1, 1)))
