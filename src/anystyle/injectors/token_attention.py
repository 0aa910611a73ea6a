"""Cross-attention to the tokens of a style image, by itself or in a block of a token stylizer."""

from jaxtyping import Float
from torch import Tensor

from anystyle.injectors.cross_attention import CrossAttention
from anystyle.nn.attention import Block
from anystyle.ranges import AtLeastOne


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
