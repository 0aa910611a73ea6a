"""Consistency: whether stylized views show one scene, by local correlation where photographs of it agree."""

import math
import warnings
from collections.abc import Mapping
from functools import lru_cache
from typing import ClassVar, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.contracts import Metric
from anystyle.geometry.warp import depth_around, reproject, sample_at
from anystyle.types import Comparison, Frames
from anystyle.vision.feature_cache import digests
from anystyle_metrics.optical_flow.matching import DAMPING, match
from anystyle_metrics.optical_flow.visibility import cycle_visible, inside

SIDE = 189
"""Pixels of the shorter side at which views are compared; smaller ones are compared as they are."""
FINE, COARSE, WINDOW, EXPOSURE = 3 / 378, 6 / 378, 9 / 378, 16 / 378
"""Standard deviations of Gaussians, of the shorter side: two whose difference is the band, that of the window in which
images are correlated, and that of the window in which photographs are made alike to be aligned."""
ROUNDING = 0.7 / 255 / 2
"""Standard deviation in the band that rounding to 8 bits may leave."""
MOVED = 3 / 378
"""How far the photographs may move what depth says, of the shorter side."""
STEPS, SPREAD = 5, 3 / 378
"""Least-squares steps of that alignment, and the standard deviation of their window, of the shorter side."""
TOLERANCE = 0.02
"""How much farther than what the second view shows a point may be, relative, and still be seen."""
LEAST = 0.03
"""Of a view, the share that another one sees of a pair that is compared."""
LONG = 0.5
"""Pairs of which the second view sees less than this of the first one's points are long, the others short."""
MOST = 20
"""The pairs of a scene that are compared at most."""
FINER = 2 / 3
"""The band in which photographs verify pixels, relative to the one that is judged."""
AGREE, ALIKE, APART = 0.5, 0.6, 0.5
"""Photographs verify a pixel where they correlate by more than ``AGREE``; they verify a pair where this is so in
``ALIKE`` of the pixels that it sees, and their own score is at most ``APART``."""
BLOCK = 32
"""Columns of an image that are smoothed at once."""
EVIDENCE = 0.1
"""The share of verified pixels in which a result has more contrast than ``ROUNDING``, for it to be judged."""


COLUMNS = ("first", "second", "overlap", "coverage", "verified", "consistency", "consistency_flicker")
"""What is known of each pair."""
FOLLOWED = "consistency: without depth and cameras, pixels are followed by flow between the photographs"
TOO_FLAT = "the views are too flat or too blurred to judge"
ONE_VIEW = "one view has no other to agree with"
NO_EVIDENCE = "the photographs agree in no pair of views: too little overlap, or depth or cameras are wrong"


class Links(NamedTuple):
    """Where pixels of the first views of pairs are seen in the second ones.

    Args:
        first: Places of the first views; likewise ``second``.
        overlap: The share of the first view's points that the second one sees.
        flow: Displacement in pixels.
        seen: Whether the second view sees the pixel, as far as geometry says.
        verified: Whether the photographs agree there, too; nowhere in pairs that they do not verify.
    """

    first: Int[Tensor, " M"]
    second: Int[Tensor, " M"]
    overlap: Float[Tensor, " M"]
    flow: Float[Tensor, "M 2 H W"]
    seen: Bool[Tensor, "M H W"]
    verified: Bool[Tensor, "M H W"]

    def aligned(self, views: Float[Tensor, "V 3 H W"]) -> tuple[Float[Tensor, "M 3 H W"], Float[Tensor, "M 3 H W"]]:
        """The first views, and the second ones moved onto them; bilinear weights would soften one of the two."""
        return views[self.first], sample_at(views[self.second], self.flow, "bicubic", "border")


class Windows:
    """Gaussian windows around pixels, in which only the pixels of a mask count.

    Args:
        mask: The pixels that count.
    """

    def __init__(self, mask: Bool[Tensor, "M H W"]) -> None:
        self.mask = mask
        self._kept = mask[:, None].float()
        self._sums: dict[float, Float[Tensor, "M 1 H W"]] = {}  # one mask is asked for many results

    def mean(self, values: Float[Tensor, "M C H W"], deviation: float) -> Float[Tensor, "M C H W"]:
        """The mean around each pixel, 0 where none counts; the standard deviation is of the shorter side."""
        sigma = deviation * min(self.mask.shape[-2:])
        if sigma not in self._sums:
            self._sums[sigma] = _blurred(self._kept, sigma).clamp_min(1e-6)
        return _blurred(values * self._kept, sigma) / self._sums[sigma]


def _blurred(values: Float[Tensor, "M C H W"], sigma: float) -> Float[Tensor, "M C H W"]:
    return _smoothed(_smoothed(values, sigma).mT, sigma).mT


def _smoothed(values: Float[Tensor, "M C H W"], sigma: float) -> Float[Tensor, "M C H W"]:
    """Rows times a matrix of Gaussians, the part of it around each block of columns that is not 0."""
    weights, reach, width = _gaussian(values.shape[-1], sigma).to(values), math.ceil(3 * sigma), values.shape[-1]
    blocks = ((start, max(0, start - reach)) for start in range(0, width, BLOCK))
    parts = [(slice(start, start + BLOCK), slice(low, start + BLOCK + reach)) for start, low in blocks]
    return torch.cat([values[..., near] @ weights[near, block] for block, near in parts], dim=-1)


@lru_cache(64)
def _gaussian(size: int, sigma: float) -> Float[Tensor, "N N"]:
    places = torch.arange(size, dtype=torch.float64)
    weights = torch.exp(-((places - places[:, None]) / sigma).square() / 2)
    return weights.where(weights > math.exp(-4.5), 0.0)  # to three standard deviations


def correlation(
    first: Float[Tensor, "M C H W"], second: Float[Tensor, "M C H W"], windows: Windows, scale: float = 1.0
) -> tuple[Float[Tensor, "M H W"], Float[Tensor, "M H W"]]:
    """Local correlation of aligned images in the band, over all channels at once, and the smaller local contrast.

    ``scale`` multiplies the band and the window.
    """
    both = torch.cat([first, second], dim=1)
    x, y = (windows.mean(both, FINE * scale) - windows.mean(both, COARSE * scale)).chunk(2, dim=1)
    products = torch.stack([(x * x).sum(1), (y * y).sum(1), (x * y).sum(1)], dim=1)
    xx, yy, xy = windows.mean(products, WINDOW * scale).unbind(1)
    # Below what rounding leaves there is nothing to correlate, and the quotient falls to 0.
    return xy / (xx * yy).sqrt().clamp_min(ROUNDING**2), torch.minimum(xx, yy).sqrt()


def disagreement(
    first: Float[Tensor, "M C H W"], second: Float[Tensor, "M C H W"], windows: Windows
) -> Float[Tensor, " M"]:
    """1 less the mean local correlation of aligned images, weighted by contrast; ``nan`` where there is none."""
    rho, contrast = correlation(first, second, windows)
    evidence = ((contrast > ROUNDING) & windows.mask).sum((1, 2)) / windows.mask.sum((1, 2))
    weight = contrast * windows.mask
    return torch.where(evidence >= EVIDENCE, 1 - (weight * rho).sum((1, 2)) / weight.sum((1, 2)), torch.nan)


def colour_shift(
    views: Float[Tensor, "V 3 H W"], first: Float[Tensor, "M 3 H W"], second: Float[Tensor, "M 3 H W"], mask: Tensor
) -> Float[Tensor, "M 3"]:
    """The change of mean colour of aligned images ``[M, H, W]`` of a mask, in standard deviations of all views."""
    shift = ((first - second) * mask[:, None]).sum((2, 3)) / mask.sum((1, 2))[:, None]
    return shift / views.std((0, 2, 3)).clamp_min(ROUNDING)


def flicker(shift: Float[Tensor, "M 3"], allowed: Float[Tensor, "M 3"]) -> Float[Tensor, " M"]:
    """Half the mean square of a shift, less the share in [0, 1] of the photographs' own that explains most of it."""
    share = ((shift * allowed).sum(1) / allowed.square().sum(1).clamp_min(1e-12)).clamp(0, 1)
    return (shift - share[:, None] * allowed).square().mean(1) / 2


def error_of_mean(
    values: Float[Tensor, " M"], first: Int[Tensor, " M"], second: Int[Tensor, " M"]
) -> Float[Tensor, ""]:
    """Standard error of the mean over pairs for other views; ``nan`` where one view is in all pairs.

    The jackknife that leaves out each view with all of its pairs: pairs that share a view are not independent.
    """
    views = torch.cat([first, second]).unique()
    means = [values[(first != view) & (second != view)].nanmean() for view in views] or [values.nanmean()]
    return (torch.stack(means).var(correction=0) * (len(views) - 1)).sqrt()


def link(photographs: Float[Tensor, "V 3 H W"], frames: Frames | None, rough: Frames | None) -> Links:
    """The pairs of views that overlap, from depth and cameras or else by flow, corrected and verified by photographs.

    ``rough`` are the same views in a small size, to choose the pairs by.
    """
    pairs = _neighbours(photographs) if rough is None else _overlapping(rough)
    ends = zip(*(places.split(1) for places in pairs), strict=True)
    parts = [_followed(photographs, *end) if frames is None else _projected(frames, *end) for end in ends]
    overlap, flow, seen = map(torch.cat, zip(*parts, strict=True))
    flow = _corrected(photographs, Links(*pairs, overlap, flow, seen, seen))
    seen = seen & inside(flow)  # the correction may lead outside
    links = Links(*pairs, overlap, flow, seen, seen)
    first, second = links.aligned(photographs)
    rho, contrast = correlation(first, second, Windows(seen), FINER)
    verified = seen & ((rho > AGREE) | (contrast < 4 * ROUNDING))
    own = disagreement(first, second, Windows(verified))
    agree = (verified.sum((1, 2)) >= ALIKE * seen.sum((1, 2))) & (own <= APART)
    return links._replace(verified=verified & agree[:, None, None])


def _neighbours(photographs: Float[Tensor, "V 3 H W"]) -> tuple[Tensor, Tensor]:
    """The places of pairs, the nearest in the sequence first."""
    first, second = torch.combinations(torch.arange(len(photographs), device=photographs.device)).unbind(1)
    nearest = (second - first).argsort(stable=True)[:MOST]
    return first[nearest], second[nearest]


def _overlapping(rough: Frames) -> tuple[Tensor, Tensor]:
    """The places of pairs of which the second view sees enough of the first, from the most to the least of it."""
    pairs = torch.combinations(torch.arange(len(rough.images), device=rough.images.device))
    parts = [_projected(rough, *batch.unbind(1)) for batch in pairs.split(len(rough.images))]
    overlap, seen = torch.cat([part[0] for part in parts]), torch.cat([part[2].float().mean((1, 2)) for part in parts])
    order = overlap.argsort(descending=True)
    order = order[seen[order] >= LEAST]
    order = order[torch.linspace(0, len(order) - 1, min(MOST, len(order))).round().long()]
    first, second = pairs[order].unbind(1)
    return first, second


def _projected(
    frames: Frames, first: Int[Tensor, " M"], second: Int[Tensor, " M"]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 2 H W"], Bool[Tensor, "M H W"]]:
    """Overlap, displacement and visibility of pairs by depth; what the second view has no depth of may be seen."""
    assert frames.depth is not None and frames.world_from_camera is not None and frames.intrinsics is not None
    depth, other = frames.depth[first], frames.depth[second]
    motion = torch.linalg.solve(frames.world_from_camera[second], frames.world_from_camera[first])
    there = reproject(depth, frames.intrinsics[first], frames.intrinsics[second], motion)
    _, farthest = depth_around(other, there.displacement)
    seen = there.inside & ((farthest == 0) | (there.depth <= farthest * (1 + TOLERANCE)))
    overlap = seen.sum((1, 2)) / (depth > 0).sum((1, 2)).clamp_min(1)
    return overlap, there.displacement.where(there.inside[:, None], 0), seen


def _followed(
    photographs: Float[Tensor, "V 3 H W"], first: Int[Tensor, " M"], second: Int[Tensor, " M"]
) -> tuple[Float[Tensor, " M"], Float[Tensor, "M 2 H W"], Bool[Tensor, "M H W"]]:
    """The same by flow between photographs; a pixel is seen if the flow back returns to it."""
    here, there = photographs[first], photographs[second]
    flow = match(here, there)
    seen = cycle_visible(flow, match(there, here))
    share = seen.float().mean((1, 2))
    return share, flow, seen & (share >= LEAST)[:, None, None]


def _corrected(photographs: Float[Tensor, "V 3 H W"], links: Links) -> Float[Tensor, "M 2 H W"]:
    """The displacements nearby by which photographs, made alike in contrast and exposure, align best.

    Least-squares steps in windows (Lucas and Kanade 1981), at most one pixel along each axis.
    """
    side = min(photographs.shape[-2:])
    gray, everywhere = photographs.mean(1, keepdim=True), Windows(torch.ones_like(photographs[:, 0]).bool())
    centred = gray - everywhere.mean(gray, EXPOSURE)
    alike = centred / (everywhere.mean(centred.square(), EXPOSURE).sqrt() + 4 * ROUNDING)
    source, seen = alike[links.first], Windows(links.seen)
    dy, dx = torch.gradient(source, dim=(2, 3))
    xx, yy, xy = seen.mean(torch.cat([dx * dx, dy * dy, dx * dy], dim=1), SPREAD).split(1, dim=1)
    xx, yy = xx + DAMPING, yy + DAMPING
    flow = links.flow
    for _ in range(STEPS):
        error = source - sample_at(alike[links.second], flow, "bicubic", "border")
        x, y = seen.mean(torch.cat([dx * error, dy * error], dim=1), SPREAD).split(1, dim=1)
        update = torch.cat([yy * x - xy * y, xx * y - xy * x], dim=1) / (xx * yy - xy.square())
        flow = links.flow + (flow + update.clamp(-1, 1) - links.flow).clamp(-MOVED * side, MOVED * side)
    return flow


class Consistency(Metric):
    """Whether views show one scene: local correlation of views along correspondences that photographs verify.

    Photographs of a real scene are consistent, and score better than stylized renders of it, which they do not by RMSE
    or LPIPS along optical flow: flow errs, exposures and highlights change, and what has little contrast has little
    error. Here correspondences come from depth and cameras (without either, from flow between the photographs), are
    moved by up to 3 pixels of 378 to where the photographs align best, and count only where the photographs correlate.
    They are found once for a scene, and are the same for all of its styles.

    ``consistency``, in [0, 2]: of each pair of views, ``1 - sum w c / sum w`` over pixels, with the local correlation
    ``c = E[xy] / sqrt(E[xx] E[yy])`` of the two in one band (difference of Gaussians with standard deviations of 3 and
    6 pixels of 378), all channels together, in a Gaussian window of 9 pixels, and ``w = sqrt(min(E[xx], E[yy]))``;
    all windows are normalised by the mask. 0 is an exact warp, and 1 is expected of unrelated content; independent
    content that makes up a share ``k`` of one view's variance gives ``1 - sqrt(1 - k)``. It does not change with one
    gain and offset of all channels, nor by negation. The mean over pairs, and over those that share at least
    (``short``) or less than (``long``) half of what the first view shows, whatever lies between them in the sequence.

    ``consistency_flicker``, at least 0: half the squared change of a pair's mean colour over the same pixels, in
    standard deviations of the result's colours, as far as it does not follow the photographs' own change of exposure.
    That of photographs is 0 by definition.

    ``consistency_error`` is the standard error of a scene's ``consistency`` for other views of it
    (:func:`error_of_mean`), ``nan`` of less than three.

    ``consistency_coverage`` is the share of the first views' pixels that are compared, and ``consistency_verified`` the
    share of visible pixels where the photographs agree. Pairs on which photographs do not agree with themselves
    (verified below 0.6, or their own score above 0.5) are left out, as are results with less contrast in the band than
    rounding leaves: flat or very blurred ones. Where nothing is left there is no coverage, and scores are ``nan``,
    with a warning.

    It does not see pixel noise and errors of less than about 3 pixels of 378, which lie below the band, what a style
    has removed, and wrong geometry that all views share.

    Attributes:
        pairs: Of the last row, a dict for each pair with its views' places, overlap, coverage and scores.

    Example:
        >>> from anystyle.types import Cameras
        >>> views = torch.rand(1, 1, 3, 64, 64).expand(1, 2, 3, 64, 64)
        >>> intrinsics = torch.tensor([[64.0, 0, 32], [0, 64, 32], [0, 0, 1]]).repeat(1, 2, 1, 1)
        >>> cameras = Cameras(torch.eye(4).repeat(1, 2, 1, 1), intrinsics, (64, 64))
        >>> scores = Consistency()(views, views, cameras=cameras, depth=torch.ones(1, 2, 64, 64))
        >>> round(float(scores["consistency"]), 3)
        0.0
    """

    better: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("consistency", "consistency_short", "consistency_long", "consistency_flicker"), "lower"),
        "consistency_error": "lower",
        **dict.fromkeys(("consistency_coverage", "consistency_verified"), "higher"),
    }
    takes = ("preds", "target", "cameras", "depth")
    full_state_update = False
    totals: Tensor
    rows: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.pairs: list[dict[str, float]] = []
        self._lacking = NO_EVIDENCE
        # The last scene's pairs, their windows and the photographs' own change of colour in each, for its next style.
        self._links: tuple[list[str], Links, Windows, Tensor] | None = None
        self.add_state("totals", torch.zeros(len(self.better), dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros(len(self.better), dtype=torch.long), dist_reduce_fx="sum")

    def update(self, comparison: Comparison) -> None:
        for row in range(len(comparison.stylized)):
            values = torch.tensor(self._row(comparison, row), dtype=torch.float64, device=self.totals.device)
            self.totals += values.nan_to_num(0.0)
            self.rows += ~values.isnan()

    def compute(self) -> dict[str, Tensor]:
        if int(self.rows[0]) == 0:
            warnings.warn(f"consistency: {self._lacking}; the scores are nan", stacklevel=2)
        return dict(zip(self.better, (self.totals / self.rows).float(), strict=True))  # nan where there is no row

    def _row(self, comparison: Comparison, row: int) -> list[float]:
        """The scores of one style of a scene, in the order of ``better``."""
        links, windows, allowed = self._linked(comparison, row)
        views = _small(comparison.stylized[row], SIDE)
        first, second = links.aligned(views)
        structure = disagreement(first, second, windows)
        changes = flicker(colour_shift(views, first, second, links.verified), allowed)
        changes = changes.where(~structure.isnan(), torch.nan)
        self._lacking = TOO_FLAT if len(structure) else NO_EVIDENCE if len(views) > 1 else ONE_VIEW
        coverage, share = links.verified.float().mean((1, 2)), links.verified.sum((1, 2)) / links.seen.sum((1, 2))
        known = (links.first, links.second, links.overlap, coverage, share, structure, changes)
        table = zip(*(column.tolist() for column in known), strict=True)
        self.pairs = [dict(zip(COLUMNS, values, strict=True)) for values in table]
        coverage, share = (values if len(values) else values.new_zeros(1) for values in (coverage, share))
        short = links.overlap >= LONG
        error = error_of_mean(structure, links.first, links.second)
        parts = (structure, structure[short], structure[~short], changes, error, coverage, share)
        return [float(part.double().nanmean()) for part in parts]

    def _linked(self, comparison: Comparison, row: int) -> tuple[Links, Windows, Tensor]:
        """The verified pairs of a scene and their change of colour, kept for the next style."""
        depth, cameras, parts = comparison.depth, comparison.cameras, [comparison.content[row]]
        if depth is not None and cameras is not None:
            parts += [depth[row], cameras.world_from_camera[row], cameras.intrinsics[row]]
        key = [digest for part in parts for digest in digests(part)]
        if self._links is None or key != self._links[0]:
            known, photographs = _frames(comparison, row, SIDE), _small(comparison.content[row], SIDE)
            if known is None:
                warnings.warn(FOLLOWED, stacklevel=5)
            links = link(photographs, known, _frames(comparison, row, SIDE // 4))
            links = Links(*(values[links.verified.flatten(1).any(1)] for values in links))
            allowed = colour_shift(photographs, *links.aligned(photographs), links.verified)
            self._links = (key, links, Windows(links.verified), allowed)
        return self._links[1:]


def _small(images: Float[Tensor, "V 3 H W"], side: int) -> Float[Tensor, "V 3 h w"]:
    """Images with at most ``side`` pixels on the shorter side."""
    return F.interpolate(images, size=_size(images, side), mode="bicubic", antialias=True).clamp(0, 1)


def _size(images: Tensor, side: int) -> tuple[int, int]:
    height, width = images.shape[-2:]
    scale = min(1.0, side / min(height, width))
    return round(height * scale), round(width * scale)


def _frames(comparison: Comparison, row: int, side: int) -> Frames | None:
    """The photographs of a row with depth and cameras, as :func:`_small` makes them."""
    if comparison.depth is None or comparison.cameras is None:
        return None
    size = _size(comparison.content, side)
    cameras = comparison.cameras.resized(size)
    depth = F.interpolate(comparison.depth[row][None], size, mode="nearest-exact")[0]
    return Frames(_small(comparison.content[row], side), depth, cameras.world_from_camera[row], cameras.intrinsics[row])
