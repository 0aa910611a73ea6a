"""Reconstructions: from views to the scene that is styled."""

from collections.abc import Callable, Sequence

from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Reconstruction, Renderer
from anystyle.types import OnProgress, Reconstructed, Scene, Views, no_progress


class Feedforward(Reconstruction):
    """What the backbone predicts in a single pass, as in the paper; cameras need not be known."""

    def __call__(
        self,
        views: Views,
        encode: Callable[[Views], Scene],
        renderer: Renderer,
        *,
        points: Sequence[Float[Tensor, "_ 3"]] | None = None,
        on_progress: OnProgress = no_progress,
    ) -> Reconstructed:
        """Encode the views; nothing else."""
        return Reconstructed(encode(views), {})
