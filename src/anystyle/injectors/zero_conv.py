"""The paper's injector: a projected style embedding added through a zero-initialised 1x1 convolution."""

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.types import Tokens


class ZeroConv(Injector):
    """Add one vector to every patch token: ``tokens + zero_proj(fc(z))`` (paper Eq. 4; ControlNet's zero convolution).

    A 1x1 convolution of a map that is constant in space is one matrix-vector product, so the term is computed on the
    vector and broadcast: the same function at a cost that does not grow with the image.

    Args:
        dim: Channels at the site.
        style_dim: Dimensions of the style embedding.
        hidden: Width of the projection's hidden layer, at most twice ``dim`` (published: 1024 at token sites, 256 at
            the direct site's 128 channels).
        gain: Of the embedding. A unit vector's entries shrink with its dimensions, and with them what a style changes
            at first; the root of ``style_dim`` makes up for it where training is short (published: 1).
        special_tokens: Whether camera and register tokens are styled too; the paper says all tokens, the published
            weights were trained with patches only.
    """

    def __init__(
        self, *, dim: int, style_dim: int, hidden: int = 1024, gain: float = 1.0, special_tokens: bool = False
    ) -> None:
        super().__init__()
        self.gain = gain
        width = min(hidden, 2 * dim)
        self.special_tokens = special_tokens
        self.fc = nn.Sequential(nn.Linear(style_dim, width), nn.ReLU(), nn.Linear(width, dim))
        self.zero_proj = nn.Linear(dim, dim)
        nn.init.zeros_(self.zero_proj.weight)
        nn.init.zeros_(self.zero_proj.bias)

    def forward(self, tokens: Tokens, style: Float[Tensor, "B D"]) -> Tokens:
        """Shift the tokens by the style's vector."""
        shift = self.zero_proj(self.fc(self.gain * style.to(self.zero_proj.weight.dtype)))[:, None, None]
        if self.special_tokens:
            return tokens.with_data(tokens.data + shift)
        return tokens.with_patches(tokens.patches + shift)
