"""ArtFID: style match and content preservation in one number (Wright and Ommer, GCPR 2022)."""

import warnings
from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from torch import Tensor

from anystyle.metrics._networks import NetworkMetric, image_vectors, lpips_of_pairs, stacked
from anystyle.metrics._pairs import Pairs, mean_per_row, pairs, with_style_images
from anystyle.metrics.frechet import frechet_distance, frechet_infinity
from anystyle.perception import embeddings, lpips
from anystyle.perception.sources import Weights
from anystyle.types import Comparison

FID_SIZE = {"reference": 512, "corrected": 299}
LPIPS_SIZE = 512


class ArtFID(NetworkMetric):
    """``(1 + LPIPS) (1 + FID)``: LPIPS to the photographs, FID to the style images (eval_artfid.py, of StyleID).

    FID is the Fréchet distance of features of an Inception network that was trained on paintings; a style image counts
    as often as it has stylized views. ``fid_infinity`` extrapolates to endless images; ``art_fid`` is computed from it.

    Args:
        variant: ``reference``: 8 bits, the shorter side 512 for both networks, and ``fid_infinity`` from samples of
            5000 and more, so that with fewer images it is FID. ``corrected``: nothing rounded, 299 pixels for the
            Inception network as in its training, and a true extrapolation from the images there are; a warning where
            these are fewer than features.
    """

    better: ClassVar[Mapping[str, str]] = {
        "art_fid": "lower",
        "fid": "lower",
        "fid_infinity": "lower",
        "lpips": "lower",
    }
    stylized: list[Tensor]
    style: list[Tensor]
    total: Tensor
    rows: Tensor

    def __init__(self, *, variant: Literal["reference", "corrected"] = "reference", weights: Weights = "auto") -> None:
        super().__init__()
        self.rounded = variant == "reference"
        self.size = FID_SIZE[variant]
        self.inception = embeddings.load_art_inception(weights)
        self.network = lpips.load("alex", weights)
        self.declare(self.inception.source, self.network.source, figures=["art_fid"])
        self.declare(self.inception.source, figures=["fid", "fid_infinity"])
        self.declare(self.network.source, figures=["lpips"])
        self.add_state("stylized", [], dist_reduce_fx="cat")
        self.add_state("style", [], dist_reduce_fx="cat")
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`; rows without a style image are left out."""
        comparison, style = with_style_images(comparison)
        distances = mean_per_row(comparison, self._distances)
        self.total += distances.sum()
        self.rows += distances.numel()
        self.stylized += [self._vectors(batch.preds) for batch in pairs(comparison)]
        self.style.append(self._vectors(style).repeat_interleave(comparison.stylized.shape[1], 0))

    def compute(self) -> dict[str, Tensor]:
        if int(self.rows) == 0:
            warnings.warn("art_fid: nothing to average; the figures are nan", stacklevel=2)
        # 0 / 0 is the nan that is meant.
        distance = (self.total / self.rows).float()
        stylized, style = stacked(self.stylized), stacked(self.style)
        if len(stylized) < 2:
            if len(stylized) == 1:
                warnings.warn("art_fid: one image alone has no covariance; the figure is nan", stacklevel=2)
            nan = torch.full_like(distance, float("nan"))
            return {"art_fid": nan, "fid": nan, "fid_infinity": nan, "lpips": distance}
        self._warn_of_few(stylized, style)
        fid = frechet_distance(stylized, style)
        fid_infinity = frechet_infinity(
            stylized, style, smallest=5000 if self.rounded else max(2, stylized.shape[0] // 2)
        )
        art_fid = (1 + distance) * (1 + fid_infinity)
        return {"art_fid": art_fid.float(), "fid": fid.float(), "fid_infinity": fid_infinity.float(), "lpips": distance}

    def _warn_of_few(self, stylized: Tensor, style: Tensor) -> None:
        num_images, dim = stylized.shape
        if style.unique(dim=0).shape[0] == 1:
            warnings.warn(
                "art_fid: there is one style image only, whose features have no spread; FID measures the mean alone",
                stacklevel=3,
            )
        if not self.rounded and num_images < dim:
            warnings.warn(
                f"art_fid: {num_images} images are fewer than the {dim} features; FID is biased upwards, see kid",
                stacklevel=3,
            )

    def _distances(self, batch: Pairs) -> Tensor:
        return lpips_of_pairs(self.network, batch, size=LPIPS_SIZE, rounded=self.rounded)

    def _vectors(self, images: Tensor) -> Tensor:
        return image_vectors(self.inception, images, size=self.size, rounded=self.rounded)
