"""Feature-wise linear modulation: the style scales and shifts each channel."""

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed


class FiLM(TokenInjector):
    """Scale and shift channels: ``tokens * (1 + scale(z)) + shift(z)``.

    Perez et al., "FiLM: Visual Reasoning with a General Conditioning Layer", 2018 (arXiv:1709.07871), Eq. 2, with the
    scale predicted as its difference from 1, as its section 7.2 does. The published style injector is only the shift.

    Args:
        hidden: Width of the projection's hidden layer, at most ``expansion`` times ``dim``.
        expansion: See ``hidden``.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        hidden: int = 1024,
        expansion: int = 2,
        gain: float = 1.0,
        special_tokens: bool = False,
    ) -> None:
        super().__init__(gain, special_tokens)
        width = min(hidden, expansion * dim)
        self.fc = nn.Sequential(nn.Linear(style_dim, width), nn.ReLU(), nn.Linear(width, dim), nn.ReLU())
        self.modulation = zeroed(nn.Linear(dim, 2 * dim))

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V P C"]:
        scale, shift = self.modulation(self.fc(style))[:, None, None].chunk(2, dim=-1)
        return data * (1 + scale) + shift
