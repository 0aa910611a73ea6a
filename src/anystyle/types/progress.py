"""How all long work reports progress."""

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

    @classmethod
    def count(cls, stage: str, done: int, total: int) -> "Progress":
        """The state of a stage of ``total`` equal steps."""
        return cls(f"{stage} {done}/{total}", done / max(total, 1))


OnProgress = Callable[[Progress], None]
"""Called every few seconds."""


def no_progress(progress: Progress) -> None:
    """No-op progress callback."""
