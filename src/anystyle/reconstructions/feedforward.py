"""The backbone's own scene."""

from collections.abc import Callable, Sequence

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Renderer
from anystyle.reconstructions.contract import Reconstruction, silent
from anystyle.types import Reconstructed, Scene, Views


class Feedforward(Reconstruction):
    """What the backbone predicts in a single pass, as in the paper; cameras need not be known."""

    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        progress: Callable[[str], None] = silent,
    ) -> Reconstructed:
        """Encode the views; nothing else."""
        return Reconstructed(encode(views), {})
