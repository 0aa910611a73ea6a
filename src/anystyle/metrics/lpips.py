"""LPIPS, with and without colour: how much content was changed, as a network sees it."""

from collections.abc import Mapping
from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor

from anystyle.metrics.base import NetworkMetric, Pairs, RowMean, mean_per_row
from anystyle.types import Comparison
from anystyle.vision import lpips
from anystyle.vision.weights import Weights


class LPIPS(NetworkMetric, RowMean):
    """LPIPS of stylized images and photographs (Zhang et al. 2018; eval_artfid.py), at least 0.

    Squared differences of a network's features of unit length, weighted by channel, averaged over pixels and added over
    layers.

    Args:
        backbone: Network of the distance; the published evaluation takes ``alex`` here.
        size: Pixels of the shorter side that images are resized to; none keeps theirs.
        variant: ``reference`` has images of 8 bits before and after they are resized, as the published script has
            them from files; ``corrected`` rounds nothing.
        weights: ``auto`` falls back to ST-LPIPS (``st_lpips``) or a stand-in, with a warning, where the published ones
            are missing.

    Example:
        >>> images = torch.rand(1, 3, 32, 32)
        >>> metric = LPIPS(weights="stand_in", size=None)
        >>> metric.update(images, images)
        >>> metric.compute()
        tensor(0.)
    """

    better: ClassVar[Mapping[str, str]] = {"lpips": "lower"}
    takes = ("preds", "target")
    gray: ClassVar[bool] = False

    def __init__(
        self,
        *,
        backbone: Literal["alex", "vgg"] = "alex",
        size: int | None = 512,
        variant: Literal["reference", "corrected"] = "reference",
        weights: Weights = "auto",
    ) -> None:
        super().__init__()
        self.size = size
        self.rounded = variant == "reference"
        self.network = lpips.load(backbone, weights)
        self.name_after(self.network.name)
        self.declare(self.network.source)

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        return mean_per_row(comparison, self._distances)

    def _distances(self, batch: Pairs) -> Float[Tensor, " M"]:
        return self.network.cached(batch.preds, batch.target, size=self.size, rounded=self.rounded, gray=self.gray)


class LPIPSGray(LPIPS):
    """LPIPS of stylized images and photographs, both without colour, so that a palette costs nothing.

    Example:
        >>> images = torch.tensor([0.114, 0.299]).view(2, 1, 1, 1) * torch.ones(2, 3, 32, 32)
        >>> primary = torch.eye(3)[[2, 0]].view(2, 3, 1, 1).expand_as(images)  # blue and red, as bright as these
        >>> metric = LPIPSGray(weights="stand_in", size=None)
        >>> metric.update(images, primary)
        >>> print(f"{metric.compute():.3f}")
        0.000
    """

    better: ClassVar[Mapping[str, str]] = {"lpips_gray": "lower"}
    gray = True
