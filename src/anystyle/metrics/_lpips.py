"""LPIPS of the pairs of a comparison, with colour or without: every image is looked at once, whoever asks."""

from pathlib import Path

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics._mean import RowMean
from anystyle.metrics._pairs import Pairs, gathered
from anystyle.perception import lpips, pictures
from anystyle.perception.lpips import Lpips
from anystyle.perception.memo import MEMO
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison


class PairLpips(RowMean):
    """The mean of LPIPS over pairs; a plugin adds its name, its documentation and its defaults.

    Args:
        backbone: Of the distance.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        rounded: Whether images have 8 bits, as files.
        gray: Whether colour is taken away first.
        weights: ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    higher_is_better = False

    def __init__(
        self, *, backbone: lpips.Backbone, size: int | None, rounded: bool, gray: bool, weights: Weights
    ) -> None:
        super().__init__()
        self.size = size
        self.rounded = rounded
        self.gray = gray
        self.network = lpips.load(backbone, weights)
        self.stand_ins = stand_ins(self.better, self.network.source)
        self.weights = checksums(self.network.source)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        """The mean over each row's views."""

        def distances(some: Pairs) -> Tensor:
            return pair_lpips(self.network, some, size=self.size, rounded=self.rounded, gray=self.gray)

        return gathered(comparison, distances)


def pair_lpips(network: Lpips, some: Pairs, *, size: int | None, rounded: bool, gray: bool) -> Float[Tensor, " M"]:
    """LPIPS of stylized images and photographs.

    Args:
        network: LPIPS.
        some: The pairs.
        size: Of the shorter side; ``None`` keeps it.
        rounded: Whether images have 8 bits, as files.
        gray: Whether colour is taken away first.
    """

    def prepared(images: Tensor) -> Tensor:
        if size is not None:
            images = pictures.resized(images, size, rounded=rounded)
        elif rounded:
            images = pictures.eight_bit(images)
        return pictures.gray(images, rounded=rounded) if gray else images

    def distances() -> Tensor:
        maps = MEMO.rows(some.content, some.content_marks, ("maps", *what), lambda x: network.describe(prepared(x)))
        return network.compare(network.describe(prepared(some.stylized)), maps)

    what = ("lpips", network.source.identity, size, rounded, gray)
    return MEMO.values([*zip(some.stylized_marks, some.content_marks, strict=True)], what, some.stylized, distances)
