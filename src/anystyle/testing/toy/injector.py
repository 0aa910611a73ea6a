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
        gain: Factor of the embedding, a unit vector. The recipes of small models set it.
    """

    def __init__(self, *, dim: int, style_dim: int, gain: float = 1.0) -> None:
        super().__init__()
        self.gain, self.scale = gain, nn.Linear(style_dim, dim)
        for parameter in self.scale.parameters():
            nn.init.zeros_(parameter)  # at initialisation every factor is exactly 1

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        factor = torch.ones_like(tokens.patches[:, :1, :1]) + self.scale(self.gain * style)[:, None, None]  # B 1 1 C
        return tokens.with_patches(tokens.patches * factor)
