"""Where the cameras of photographs come from, if not from the backbone: files of other programs, or an estimator."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import NDArray
from PIL import Image
from torch import Tensor

from anystyle.registry.catalog import Pluggable
from anystyle.types import OnProgress, Original, SourceImage, Views


class Undistortion(NamedTuple):
    """What removes the distortion of a lens."""

    apply: Callable[[Image.Image], Image.Image]
    """Takes an upright picture at any resolution."""
    intrinsics: NDArray[np.float64]
    """Intrinsics of the picture that it returns, in pixels of the stored size."""


@dataclass(frozen=True)
class StoredCamera:
    """One camera in OpenCV axes: a 4x4 pose and 3x3 intrinsics in pixels of an image of ``size``, height and width."""

    world_from_camera: NDArray[np.float64]
    intrinsics: NDArray[np.float64]
    size: tuple[int, int]
    undistortion: Undistortion | None = None

    def for_size(self, height: int, width: int) -> NDArray[np.float64]:
        """Intrinsics in pixels of the same image stored at another resolution."""
        return self.intrinsics * np.array([width / self.size[1], height / self.size[0], 1.0])[:, None]


class CameraReader(Pluggable, ABC):
    """Reads the cameras that a program stored for photographs."""

    expects: ClassVar[str]
    """What it reads, for messages: ``a COLMAP model``."""
    rank: ClassVar[int] = 0
    """Of several programs whose cameras lie in one folder, the one of lowest rank is read."""

    @abstractmethod
    def find(self, path: Path) -> Path | None:
        """The file or folder with cameras: a given file itself, or what a folder holds; ``None`` if it is not there.

        Its content is looked at no further than to tell it from other files of the same suffix.
        """

    @abstractmethod
    def read(self, path: Path, images: Sequence[Path]) -> Mapping[str, StoredCamera]:
        """The cameras by the names of image files as the program stores them: with folders and suffix, or without.

        Args:
            path: What :meth:`find` returned.
            images: The photographs, in natural order, where there are any. Cameras that the program stores without a
                name or size cannot be read without.

        Raises:
            UserError: The file is damaged, or a lens has a model that cannot be undistorted.
        """


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


class PoseEstimator(Pluggable, ABC):
    """Estimates the cameras of photographs, and undistorts the photographs."""

    min_views: ClassVar[int] = 2
    """The fewest photographs that it can work on."""
    longest: ClassVar[int] = 1600
    """Longer side in pixels that photographs are reduced to before; less than twice of it."""
    reconstruction: ClassVar[str] = "feedforward"
    """The plugin of kind ``reconstruction`` that its views are handed to unless another is chosen."""

    @abstractmethod
    def __call__(
        self, originals: Sequence[Original], *, short_side: int, multiple: int, enlarge: bool, on_progress: OnProgress
    ) -> PosedViews | Verdict:
        """Estimate the cameras of one scene's photographs.

        Args:
            originals: The photographs; frames of a video have no path.
            short_side: Shorter side of the views in pixels; rounded to a multiple.
            multiple: Both sides of the views are multiples of it.
            enlarge: Whether photographs smaller than ``short_side`` are enlarged.
            on_progress: Called every few seconds.

        Returns:
            The views with cameras; or the verdict alone where no cameras are found.
        """
