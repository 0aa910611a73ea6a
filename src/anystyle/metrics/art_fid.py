"""ArtFID: style match and content preservation in one number (Wright and Ommer, GCPR 2022)."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal

import torch
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.metrics._lpips import pair_lpips
from anystyle.metrics._pairs import checked, mean_of, pairs, row_means, style_images
from anystyle.metrics.frechet import frechet_distance, frechet_infinity
from anystyle.perception import lpips, pictures, vectors
from anystyle.perception.memo import MEMO, fingerprints
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison

FID_SIZE = {"reference": 512, "corrected": 299}
LPIPS_SIZE = 512


class ArtFID(Metric):
    """``(1 + LPIPS) (1 + FID)``: LPIPS to the photographs, FID to the style images (eval_artfid.py, of StyleID).

    FID is the Fréchet distance of features of an Inception network that was trained on paintings; a style image counts
    as often as it has stylized views. ``fid_infinity`` extrapolates to endless images; ``art_fid`` is computed from it.

    Args:
        variant: ``reference``: 8 bits, the shorter side 512 for both networks, and ``fid_infinity`` from samples of
            5000 and more, so that with fewer images it is FID. ``corrected``: nothing rounded, 299 pixels for the
            Inception network as in its training, and a true extrapolation from the images there are; a warning where
            these are fewer than features.
        weights: ``auto`` takes stand-ins where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {
        "art_fid": "lower",
        "fid": "lower",
        "fid_infinity": "lower",
        "lpips": "lower",
    }
    higher_is_better = False
    is_differentiable = False
    full_state_update = False
    stylized: list[Tensor]
    style: list[Tensor]
    total: Tensor
    rows: Tensor

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.rounded = variant == "reference"
        self.size = FID_SIZE[variant]
        self.inception = vectors.load_art_inception(weights)
        self.network = lpips.load("alex", weights)
        both = (self.inception.source, self.network.source)
        self.stand_ins = {
            **stand_ins(("art_fid",), *both),
            **stand_ins(("fid", "fid_infinity"), both[0]),
            **stand_ins(("lpips",), both[1]),
        }
        self.weights = checksums(*both)
        self.add_state("stylized", [], dist_reduce_fx="cat")
        self.add_state("style", [], dist_reduce_fx="cat")
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`; rows without a style image are left out."""
        image, given = style_images(checked(comparison))
        distances: dict[int, list[Tensor]] = {}
        for some in pairs(comparison):
            if not bool(given[some.row]):
                continue
            found = pair_lpips(self.network, some, size=LPIPS_SIZE, rounded=self.rounded, gray=False)
            distances.setdefault(some.row, []).append(found)
            self.stylized.append(self._vectors(some.stylized, some.stylized_marks))
        vectors_of_styles = self._vectors(image[given], fingerprints(image[given]))
        self.style.append(vectors_of_styles.repeat_interleave(comparison.stylized.shape[1], 0))
        means = row_means(distances)
        self.total += means.sum()
        self.rows += means.numel()

    def compute(self) -> dict[str, Tensor]:
        """See :meth:`anystyle.contracts.Metric.compute`."""
        distance = mean_of(self.total, self.rows, "art_fid")
        stylized, style = _stacked(self.stylized), _stacked(self.style)
        if stylized is None or style is None or stylized.shape[0] < 2:
            if stylized is not None:
                warnings.warn("art_fid: one image alone has no covariance; the figure is nan", stacklevel=2)
            none = torch.full_like(distance, float("nan"))
            return {"art_fid": none, "fid": none, "fid_infinity": none, "lpips": distance}
        self._caution(stylized, style)
        fid = frechet_distance(stylized, style)
        infinite = frechet_infinity(stylized, style, smallest=5000 if self.rounded else max(2, stylized.shape[0] // 2))
        art_fid = (1 + distance) * (1 + infinite)
        return {"art_fid": art_fid.float(), "fid": fid.float(), "fid_infinity": infinite.float(), "lpips": distance}

    def _caution(self, stylized: Tensor, style: Tensor) -> None:
        count, dim = stylized.shape
        if style.unique(dim=0).shape[0] == 1:
            warnings.warn(
                "art_fid: there is one style image only, whose features have no spread; FID measures the mean alone",
                stacklevel=3,
            )
        if not self.rounded and count < dim:
            warnings.warn(
                f"art_fid: {count} images are fewer than the {dim} features; FID is biased upwards, see kid",
                stacklevel=3,
            )

    def _vectors(self, images: Tensor, marks: list[str]) -> Tensor:
        def look(some: Tensor) -> list[Tensor]:
            return [self.inception(pictures.resized(some, self.size, rounded=self.rounded))]

        what = ("inception", self.inception.source.identity, self.size, self.rounded)
        return MEMO.rows(images, marks, what, look)[0]


def _stacked(parts: list[Tensor] | Tensor) -> Tensor | None:
    # After a reduction over processes the list has become one tensor.
    parts = [parts] if torch.is_tensor(parts) else parts
    return torch.cat(parts) if parts else None
