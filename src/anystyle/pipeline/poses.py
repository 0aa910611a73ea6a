"""Where the cameras of photographs come from, if not from the backbone or from files: a kind of plugin."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.data.folder import Original, SourceImage
from anystyle.registry.socket import Socket
from anystyle.types import OnProgress, Views


@dataclass(frozen=True)
class Verdict:
    """How far cameras can be trusted.

    Args:
        trust: ``good``: independently confirmed. ``doubtful``: there are cameras, and the reasons say what speaks
            against them. ``failed``: there are none.
        reasons: Plain sentences: what was left out, and what to do.
        measures: What was measured, by name.
    """

    trust: Literal["good", "doubtful", "failed"]
    reasons: tuple[str, ...]
    measures: Mapping[str, float]

    def report(self) -> dict[str, object]:
        """The entries of ``report.json`` on the cameras."""
        return {"trust": self.trust, "reasons": list(self.reasons)}


@dataclass(frozen=True)
class PosedViews:
    """The photographs whose cameras were estimated.

    Args:
        views: Undistorted, all of one size, with cameras in one frame.
        sources: Where each view comes from.
        points: For each view, sparse points in world space that it shows.
        verdict: How far the cameras can be trusted, and which photographs were left out.
        cached: Whether they were read from the cache of an earlier run.
    """

    views: Views
    sources: tuple[SourceImage, ...]
    points: tuple[Float[Tensor, "_ 3"], ...]
    verdict: Verdict
    cached: bool = False


class PoseEstimator(Socket, ABC):
    """Estimates the cameras of photographs, and undistorts the photographs."""

    min_views: ClassVar[int] = 2
    """The fewest photographs that it can work on."""
    longest: ClassVar[int] = 1600
    """Longer side in pixels that photographs are reduced to before; less than twice of it."""
    reconstruction: ClassVar[str] = "feedforward"
    """The plugin of kind ``reconstruction`` that its views are handed to unless another is chosen."""

    @abstractmethod
    def __call__(
        self,
        originals: Sequence[Original],
        *,
        short_side: int,
        multiple: int,
        enlarge: bool,
        on_progress: OnProgress,
    ) -> PosedViews | Verdict:
        """Estimate the cameras of one scene's photographs.

        Args:
            originals: The photographs; frames of a video have no path.
            short_side: Of the views, in pixels; rounded to a multiple.
            multiple: Both sides of the views are multiples of it.
            enlarge: Whether photographs smaller than ``short_side`` are enlarged.
            on_progress: Called every few seconds.

        Returns:
            The views with cameras; or the verdict alone where no cameras are found.
        """
