"""Adaptive layer normalisation: normalised tokens with the style's mean and spread, through a gate that opens."""

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed


class AdaLN(TokenInjector):
    """Add tokens with other statistics: ``tokens + gate(z) * (norm(tokens) * (1 + scale(z)) + shift(z))``.

    The adaLN-Zero of Peebles and Xie, "Scalable Diffusion Models with Transformers", 2023 (arXiv:2212.09748, section
    3.2): a layer norm without parameters of its own, scale, shift and gate predicted by one layer that starts at 0.
    There the gate multiplies a block's output; a site has no block, so here it multiplies the modulated tokens.
    Unlike FiLM, what it adds does not depend on how large a token is.

    Args:
        hidden: Width of the projection, at most twice ``dim``.
    """

    def __init__(
        self, *, dim: int, style_dim: int, hidden: int = 1024, gain: float = 1.0, special_tokens: bool = False
    ) -> None:
        super().__init__(gain, special_tokens)
        width = min(hidden, 2 * dim)
        self.norm = nn.LayerNorm(dim, eps=1e-6, elementwise_affine=False)
        self.fc = nn.Sequential(nn.Linear(style_dim, width), nn.SiLU())
        self.modulation = zeroed(nn.Linear(width, 3 * dim))

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V P C"]:
        shift, scale, gate = self.modulation(self.fc(style))[:, None, None].chunk(3, dim=-1)
        return data + gate * (self.norm(data) * (1 + scale) + shift)
