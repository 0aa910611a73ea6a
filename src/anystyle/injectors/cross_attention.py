"""Cross-attention: every token looks at a few tokens made of the style, or at those of the style image."""

from typing import Annotated

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed
from anystyle.nn.attention import Block, attended
from anystyle.ranges import AtLeastOne, Range


class CrossAttention(TokenInjector):
    """Let tokens attend to the style: ``tokens + zero_proj(attention(norm(tokens), style tokens))``.

    Style enters by cross-attention in Stylos (arXiv:2509.26455) and Styl3R (arXiv:2505.21060), whose style tokens are
    the patches of a style image. A site gives one vector, which may come from a text, so it is expanded into
    ``num_tokens`` style tokens by a learned map, as IP-Adapter does with an image's CLIP vector (Ye et al., 2023,
    arXiv:2308.06721, section 3.2.1). The same style can so do different things to different tokens, which a shift
    cannot. The output projection is 0 at initialisation.

    Args:
        num_tokens: Style tokens that the vector becomes; at least 2, for with one there is nothing to choose from.
        heads: Attention heads.
        head_dim: Channels of each head.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        num_tokens: Annotated[int, Range(ge=2)] = 8,
        heads: AtLeastOne = 4,
        head_dim: AtLeastOne = 32,
        gain: float = 1.0,
        special_tokens: bool = False,
    ) -> None:
        super().__init__(gain, special_tokens)
        self.num_tokens, self.heads = num_tokens, heads
        width = heads * head_dim
        self.style_tokens = nn.Linear(style_dim, num_tokens * width)
        self.style_norm = nn.LayerNorm(width)
        self.norm = nn.LayerNorm(dim)
        self.query = nn.Linear(dim, width, bias=False)
        # No bias: what all keys share changes no softmax, and would never learn.
        self.key = nn.Linear(width, width, bias=False)
        self.value = nn.Linear(width, width)
        self.zero_proj = zeroed(nn.Linear(width, dim))

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B *tokens D"]) -> Float[Tensor, "B V P C"]:
        coded = self.style_norm(self.coded(style))  # B K W
        parts = self.query(self.norm(data.flatten(1, 2))), self.key(coded), self.value(coded)  # B (V P) W, B K W twice
        return data + self.zero_proj(attended(*map(self._split, parts))).reshape(data.shape)

    def coded(self, style: Float[Tensor, "B D"]) -> Float[Tensor, "B K W"]:
        """The style tokens that a vector becomes."""
        return self.style_tokens(style).unflatten(-1, (self.num_tokens, -1))

    def _split(self, channels: Tensor) -> Tensor:
        return channels.unflatten(-1, (self.heads, -1)).transpose(1, 2)  # B heads rows head_dim


class TokenAttention(CrossAttention):
    """Let tokens attend to those of the style image: ``x + zero_proj(attention(norm(x), linear(style tokens)))``.

    The two networks that stylize in one pass with style tokens do so: Stylos (arXiv:2509.26455) in an aggregator, whose
    own blocks let views see each other, and Styl3R (arXiv:2505.21060) in a token stylizer ahead of the head, with
    self-attention over the tokens of all views and an MLP. At initialisation all of it is the identity. Needs a style
    encoder that gives tokens, and styles that are images.

    Args:
        heads: Attention heads.
        head_dim: Channels of each head.
        stylizer: Whether a transformer block over the tokens of all views comes first; its heads are those above.
    """

    reads_tokens = True

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        heads: AtLeastOne = 4,
        head_dim: AtLeastOne = 32,
        stylizer: bool = False,
        gain: float = 1.0,
        special_tokens: bool = False,
    ) -> None:
        super().__init__(
            dim=dim, style_dim=style_dim, num_tokens=1, heads=heads, head_dim=head_dim, gain=gain,
            special_tokens=special_tokens,
        )  # fmt: skip
        self.views = Block(dim, heads, mlp_ratio=4.0, layer_scale=0.0) if stylizer else None

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B S D"]) -> Float[Tensor, "B V P C"]:
        if self.views is not None:
            data = self.views(data.flatten(1, 2)).view_as(data)
        return super().styled(data, style)

    def coded(self, style: Float[Tensor, "B S D"]) -> Float[Tensor, "B S W"]:
        return self.style_tokens(style)
