"""The paper's injector: a projected style embedding added through a zero-initialised 1x1 convolution."""

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed


class ZeroConv(TokenInjector):
    """Add one vector to every patch token: ``tokens + zero_proj(fc(z))`` (paper Eq. 4; ControlNet's zero convolution).

    A 1x1 convolution of a map that is constant in space is one matrix-vector product, so the term is computed on the
    vector and broadcast: the same function at a cost that does not grow with the image.

    Args:
        hidden: Width of the projection's hidden layer, at most twice ``dim`` (published: 1024 at token sites, 256 at
            the direct site's 128 channels).
        gain: Factor of the embedding; see :class:`~anystyle.injectors.base.TokenInjector` (published: 1).
        special_tokens: Whether camera and register tokens are also styled; the paper says all tokens, the published
            weights were trained with patches only.
    """

    def __init__(
        self, *, dim: int, style_dim: int, hidden: int = 1024, gain: float = 1.0, special_tokens: bool = False
    ) -> None:
        super().__init__(gain, special_tokens)
        width = min(hidden, 2 * dim)
        self.fc = nn.Sequential(nn.Linear(style_dim, width), nn.ReLU(), nn.Linear(width, dim))
        self.zero_proj = zeroed(nn.Linear(dim, dim))

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V P C"]:
        return data + self.zero_proj(self.fc(style))[:, None, None]
