"""The base of injectors that change each token separately."""

from abc import abstractmethod

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Injector
from anystyle.types import Tokens


class TokenInjector(Injector):
    """Changes patch tokens, and camera and register tokens if asked to; subclasses implement :meth:`styled`.

    Args:
        dim: Channels at the site.
        style_dim: Dimensions of the style embedding.
        gain: Factor of the embedding, a unit vector. ``sqrt(style_dim)`` gives entries of unit variance, which speeds
            up short trainings.
        special_tokens: Whether camera and register tokens are styled too.
    """

    def __init__(self, gain: float, special_tokens: bool) -> None:
        super().__init__()
        self.gain = gain
        self.special_tokens = special_tokens

    def forward(self, tokens: Tokens, style: Float[Tensor, "B *tokens D"]) -> Tokens:
        style = self.gain * style.to(next(self.parameters()).dtype)
        if self.special_tokens:
            return tokens.with_data(self.styled(tokens.data, style))
        return tokens.with_patches(self.styled(tokens.patches, style))

    @abstractmethod
    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B *tokens D"]) -> Float[Tensor, "B V P C"]:
        """The tokens in each style; ``data`` is left as it is."""


def zeroed(layer: nn.Linear) -> nn.Linear:
    """A layer whose weight and bias are 0, so that what it predicts changes nothing before it has learned."""
    for parameter in layer.parameters():
        nn.init.zeros_(parameter)
    return layer
