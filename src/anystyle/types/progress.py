"""How methods, reconstructions and protocols report progress."""

from collections.abc import Callable
from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor


@dataclass(frozen=True)
class Progress:
    """The state of long work.

    Args:
        line: A line of text to show.
        done: The fraction of the work that is done, in [0, 1], where it is known.
        thumbnail: A view as it is now, sRGB in [0, 1], where there is one.
    """

    line: str
    done: float | None = None
    thumbnail: Float[Tensor, "3 _ _"] | None = None


OnProgress = Callable[[Progress], None]
"""Called every few seconds."""

OnStep = Callable[[str, int, int], None]
"""Called with the name of a stage, the number of finished steps, and the number of all steps."""


def no_progress(progress: Progress) -> None:
    """No-op progress callback."""
