"""A low-rank update of the copied blocks, with a strength of each rank that the style sets."""

from jaxtyping import Float
from torch import Tensor, nn

from anystyle.injectors.base import TokenInjector, zeroed
from anystyle.ranges import AtLeastOne


class LoRA(TokenInjector):
    """Change tokens within few directions: ``tokens + alpha / rank * up(strength(z) * down(tokens))``.

    Hu et al., "LoRA: Low-Rank Adaptation of Large Language Models", 2021 (arXiv:2106.09685, Eq. 3): ``down`` is random
    and ``up`` starts at 0. There the pair is added to a weight matrix; here it stands at a site, which is the same
    for the linear layers that read the tokens there: ``W (x + U S D x) = (W + (W U) S D) x``, an update of ``W`` of
    rank ``rank``. The style enters as the diagonal ``S = diag(strength(z))`` between the two, so that one pair of
    matrices is a family of updates, one per style. A token that is 0 stays 0.

    With ``training.learn_copies=false`` the copied blocks keep their weights and this update is all that learns, which
    is what LoRA is for; otherwise they learn beside it.

    Args:
        rank: Rank of the update, at most ``dim``.
        alpha: The update is scaled by ``alpha / rank``, so that another rank needs no other learning rate.
    """

    def __init__(
        self,
        *,
        dim: int,
        style_dim: int,
        rank: AtLeastOne = 16,
        alpha: float = 16.0,
        gain: float = 1.0,
        special_tokens: bool = False,
    ) -> None:
        super().__init__(gain, special_tokens)
        rank = min(rank, dim)
        self.factor = alpha / rank
        self.strength = nn.Linear(style_dim, rank)
        self.down = nn.Linear(dim, rank, bias=False)
        self.up = zeroed(nn.Linear(rank, dim, bias=False))

    def styled(self, data: Float[Tensor, "B V P C"], style: Float[Tensor, "B D"]) -> Float[Tensor, "B V P C"]:
        return data + self.up(self.factor * self.strength(style)[:, None, None] * self.down(data))
