"""A small network on every token, whose weights the style makes."""

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed
from anystyle.ranges import AtLeastOne


class HyperNetwork(TokenInjector):
    """Put tokens through a network made by the style: ``tokens * (1 + scale) + up relu(down [tokens, rank]) + shift``.

    ``down``, ``up``, ``scale`` and ``shift`` are all functions of the embedding (Ha et al., "HyperNetworks", 2017,
    arXiv:1609.09106, section 3.1; for image-wide filters De Brabandere et al., "Dynamic Filter Networks", 2016,
    arXiv:1605.09673). FiLM is the case without the hidden layer. With it a style can bend a channel as well as shift
    it: on colours it is a curve for each style, so dark can go to one colour and light to another.

    Beside the tokens the network reads where each lies among all tokens of the scene, ``(token - mean) / deviation``
    over views and tokens, for what is dark in one scene is light in another.

    Args:
        width: Hidden channels of the network that is made.
        hidden: Width of the layers that make it.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        width: AtLeastOne = 16,
        hidden: AtLeastOne = 256,
        gain: float = 1.0,
        special_tokens: bool = False,
    ) -> None:
        super().__init__(gain, special_tokens)
        self.dim, self.width = dim, width
        self.fc = nn.Sequential(nn.Linear(style_dim, hidden), nn.ReLU(), nn.Linear(hidden, hidden), nn.ReLU())
        self.down = nn.Linear(hidden, (2 * dim + 1) * width)
        self.up = zeroed(nn.Linear(hidden, (width + 2) * dim))
        # What is made starts as an ordinary random layer, the same for every style but for a variation.
        nn.init.normal_(self.down.bias, std=(2 * dim) ** -0.5)

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V P C"]:
        coded = self.fc(style)
        down, offset = self.down(coded).split([2 * self.dim * self.width, self.width], dim=-1)
        up, scale, shift = self.up(coded).split([self.width * self.dim, self.dim, self.dim], dim=-1)
        rows = data.flatten(1, 2)  # B (V P) C
        variance, mean = torch.var_mean(rows, dim=1, correction=0, keepdim=True)
        read = torch.cat([rows, (rows - mean) / (variance + 1e-3).sqrt()], dim=-1)
        hidden = F.relu(torch.baddbmm(offset[:, None], read, down.unflatten(-1, (2 * self.dim, self.width))))
        bent = torch.baddbmm(shift[:, None], hidden, up.unflatten(-1, (self.width, self.dim)))
        return (rows * (1 + scale[:, None]) + bent).unflatten(1, data.shape[1:3])
