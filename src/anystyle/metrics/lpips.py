"""LPIPS: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from anystyle.metrics._lpips import PairLpips
from anystyle.perception.sources import Weights


class LPIPS(PairLpips):
    """LPIPS of stylized images and photographs (Zhang et al. 2018; eval_artfid.py).

    Args:
        backbone: Of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {"lpips": "lower"}

    def __init__(
        self,
        *,
        backbone: Literal["alex", "vgg"] = "alex",
        size: int | None = 512,
        variant: Literal["reference", "corrected"] = "reference",
        weights: Weights = "auto",
    ) -> None:
        super().__init__(backbone=backbone, size=size, rounded=variant == "reference", gray=False, weights=weights)
