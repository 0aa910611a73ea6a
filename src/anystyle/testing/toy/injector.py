"""Feature-wise scaling: the smallest injector that does something."""

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.types import Tokens


class ToyInjector(Injector):
    """Scale each channel of the patch tokens: ``tokens * (1 + linear(style))``.

    Args:
        dim: Channels at the site; the framework passes it.
        style_dim: Dimensions of the style embedding; the framework passes it.
        bias: Whether every style shares a part of the scaling.
    """

    def __init__(self, *, dim: int, style_dim: int, bias: bool = True) -> None:
        super().__init__()
        self.scale = nn.Linear(style_dim, dim, bias=bias)
        for parameter in self.scale.parameters():
            nn.init.zeros_(parameter)  # at initialisation every factor is exactly 1

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        factor = torch.ones_like(tokens.patches[:, :1, :1]) + self.scale(style)[:, None, None]  # B 1 1 C
        return tokens.with_patches(tokens.patches * factor)
