"""ArtFID: style match and content preservation in one number (Wright and Ommer, GCPR 2022)."""

import warnings
from collections.abc import Mapping
from typing import ClassVar, Literal

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import accepts_tensors
from anystyle.metrics.base import NetworkMetric, mean_per_row, pairs, stacked, with_style_images
from anystyle.types import Comparison
from anystyle.vision import embeddings, lpips
from anystyle.vision.weights import Weights

FID_SIZE = {"reference": 512, "corrected": 299}
LPIPS_SIZE = 512


class ArtFID(NetworkMetric):
    """``(1 + LPIPS) (1 + FID)``: LPIPS to the photographs, FID to the style images (eval_artfid.py, of StyleID).

    FID is the Fréchet distance of features of an Inception network that was trained on paintings; a style image counts
    as often as it has stylized views. ``fid_infinity`` extrapolates to infinitely many images; ``art_fid`` uses it.

    Args:
        variant: ``reference``: 8 bits, the shorter side 512 for both networks, and ``fid_infinity`` from samples of
            5000 and more, so that with fewer images it is FID. ``corrected``: nothing rounded, 299 pixels for the
            Inception network as in its training, and a true extrapolation from the images there are; a warning where
            these are fewer than features, and ``nan`` where so few extrapolate to less than 0.
        weights: ``auto`` falls back to ST-LPIPS (``st_lpips``) or a stand-in, with a warning, where the published ones
            are missing.

    Example:
        >>> images = torch.rand(2, 3, 32, 32, generator=torch.Generator().manual_seed(0))
        >>> metric = ArtFID(weights="stand_in")
        >>> metric.update(images, images, style=images)  # results are photographs and styles
        >>> print(f"{metric.compute()['art_fid']:.3f}")
        1.000
    """

    better: ClassVar[Mapping[str, str]] = dict.fromkeys(("art_fid", "fid", "fid_infinity", "lpips"), "lower")
    takes = ("preds", "target", "style")
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
        self.name_after(self.network.name)
        self.declare(self.inception.source, self.network.source, scores=["art_fid"])
        self.declare(self.inception.source, scores=["fid", "fid_infinity"])
        self.declare(self.network.source, scores=[self.network.name])
        self.add_state("stylized", [], dist_reduce_fx="cat")
        self.add_state("style", [], dist_reduce_fx="cat")
        self.add_state("total", torch.zeros((), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros((), dtype=torch.long), dist_reduce_fx="sum")

    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        comparison, style = with_style_images(comparison)
        distances = mean_per_row(
            comparison, lambda each: self.network.cached(each.preds, each.target, size=LPIPS_SIZE, rounded=self.rounded)
        )
        self.total += distances.sum()
        self.rows += distances.numel()
        self.stylized += [self._vectors(batch.preds) for batch in pairs(comparison)]
        self.style.append(self._vectors(style).repeat_interleave(comparison.stylized.shape[1], 0))

    def compute(self) -> dict[str, Tensor]:
        if int(self.rows) == 0:
            warnings.warn("art_fid: nothing to average; the scores are nan", stacklevel=2)
        distance = (self.total / self.rows).float()  # nan where there is no row
        stylized, style = stacked(self.stylized), stacked(self.style)
        if len(stylized) < 2:
            if len(stylized) == 1:
                warnings.warn("art_fid: one image alone has no covariance; the score is nan", stacklevel=2)
            nan = torch.full_like(distance, float("nan"))
            return {"art_fid": nan, "fid": nan, "fid_infinity": nan, self.network.name: distance}
        num_images, dim = stylized.shape
        if style.unique(dim=0).shape[0] == 1:
            warnings.warn(
                "art_fid: there is one style image only, whose features have no spread; FID measures the mean alone",
                stacklevel=2,
            )
        fid = frechet_distance(stylized, style)
        smallest = 5000 if self.rounded else max(2, num_images // 2)
        fid_infinity = fid if num_images <= smallest else frechet_infinity(stylized, style, smallest=smallest)
        if not self.rounded and num_images < dim:
            few = f"{num_images} images are fewer than the {dim} features; FID is biased upwards, see kid"
            if fid_infinity < -1e-3:
                fid_infinity, few = torch.full_like(fid, float("nan")), f"{few}; extrapolated it is below 0, hence nan"
            warnings.warn(f"art_fid: {few}", stacklevel=2)
        art_fid = (1 + distance) * (1 + fid_infinity)
        scores = {"art_fid": art_fid.float(), "fid": fid.float(), "fid_infinity": fid_infinity.float()}
        return scores | {self.network.name: distance}

    def _vectors(self, images: Tensor) -> Tensor:
        return self.inception.vectors(images, size=self.size, rounded=self.rounded)


def frechet_distance(first: Float[Tensor, "N D"], second: Float[Tensor, "M D"]) -> Float[Tensor, ""]:
    """Fréchet distance of the Gaussians fitted to two sets of features, a row a sample (Heusel et al., 2017, Eq. 6).

    With centred and scaled features ``A`` and ``B``, the covariances are ``AᵀA`` and ``BᵀB``, and the trace of
    ``sqrtm(AᵀA BᵀB)`` is the sum of the singular values of ``A Bᵀ``: an N x M matrix, exact also where N < D makes
    both covariances singular, and cheap there. Where both sets are larger than D, the same identity is used on D x D
    square roots from eigenvalues.

    In float64; the covariances are the unbiased ones.
    """
    for name, features in (("first", first), ("second", second)):
        if features.shape[0] < 2:
            raise ValueError(f"the {name} set has {features.shape[0]} samples; a covariance needs at least 2")
        if not features.isfinite().all():
            raise ValueError(f"the {name} set of features holds values that are not finite")
    mean_gap = (first.double().mean(0) - second.double().mean(0)).square().sum()
    a, b = _scaled(first), _scaled(second)
    spread = a.square().sum() + b.square().sum()
    return mean_gap + spread - 2 * torch.linalg.svdvals(_compact(a) @ _compact(b).T).sum()


def frechet_infinity(
    first: Float[Tensor, "N D"], second: Float[Tensor, "M D"], *, smallest: int, points: int = 15
) -> Float[Tensor, ""]:
    """The Fréchet distance extrapolated to infinitely many samples (Chong and Forsyth, CVPR 2020).

    Distances of growing samples of ``first``, drawn with a fixed seed, lie close to a line over one divided by their
    size; the line's value at 0 is the score. With no more rows than the ``smallest`` sample, it is the plain distance.
    """
    count = first.shape[0]
    if count <= smallest:
        return frechet_distance(first, second)
    # A sum does not depend on the order of rows, but a sample does: rows are sorted, then drawn.
    rows = first[first.double().mean(1).argsort(stable=True)]
    generator = torch.Generator().manual_seed(0)
    sizes = torch.linspace(smallest, count, points).round().long().unique().tolist()
    distances = []
    for size in sizes:
        drawn = torch.randperm(count, generator=generator)[:size].to(first.device)
        distances.append(frechet_distance(rows[drawn], second))
    inverse = 1 / torch.tensor(sizes, dtype=torch.float64, device=first.device)
    design = torch.stack([torch.ones_like(inverse), inverse], dim=1)
    return torch.linalg.lstsq(design, torch.stack(distances)[:, None]).solution[0, 0]


def _scaled(features: Float[Tensor, "N D"]) -> Float[Tensor, "N D"]:
    features = features.double()
    return (features - features.mean(0)) / (features.shape[0] - 1) ** 0.5


def _compact(scaled: Float[Tensor, "N D"]) -> Float[Tensor, "R D"]:
    """A matrix with the same Gram matrix ``AᵀA`` and at most D rows."""
    return scaled if scaled.shape[0] <= scaled.shape[1] else torch.linalg.qr(scaled, mode="r").R
