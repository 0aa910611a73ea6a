"""Warp consistency: whether a stylized frame, moved along the optical flow, looks like a later stylized frame."""

import warnings
from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Correspondence, accepts_tensors
from anystyle.geometry.warp import backward_warp, softmax_splat
from anystyle.metrics.base import NetworkMetric
from anystyle.types import Comparison, Flow, Frames
from anystyle.types.shapes import check_tensor, check_value
from anystyle.vision import lpips, preprocess
from anystyle.vision.feature_cache import batch_size, digests
from anystyle.vision.weights import Weights

RANGES = {"short": 1, "long": 7}
"""How many frames lie between the frames of a pair."""

MAX_LOGIT = 10.0
"""Logits of the splatting are clamped to this absolute value, as published."""

MIN_WEIGHT = 0.5
"""Of a corrected splat: the weight that a pixel must receive to count."""


Neighbours = list[tuple[int, int]]
"""The places of the frames of pairs."""

Flows = list[tuple[Tensor, Tensor | None]]
"""Displacement and visibility of pairs, batch by batch; no visibility where the metric has no use for it."""


class Warped(NamedTuple):
    """A source frame warped to the target, and the target; both are 0 except where pixels are ``seen`` to land."""

    image: Float[Tensor, "M 3 H W"]
    target: Float[Tensor, "M 3 H W"]
    seen: Bool[Tensor, "M 1 H W"]


class WarpConsistency(NetworkMetric):
    """Masked RMSE and LPIPS of neighbouring frames (t, t+1) and distant ones (t, t+7), as Stylos and StyleGaussian do.

    Frames are counted in their sequence, also where some are missing.
    A frame is warped along the flow by softmax splatting and compared with the frame that the flow leads to. Each row
    counts as the mean of its pairs; rows are averaged.

    Args:
        flow_from: ``stylized`` frames, as published; or the ``content`` frames, whose flow a style cannot disturb and
            which is computed once for all styles. ``None`` takes the variant's: ``stylized`` in ``reference``,
            ``content`` in ``corrected``.
        variant: ``reference`` is the published script: images in [0, 255] for LPIPS and for the splatting's logits,
            which saturate; RMSE over all pixels, so that a hole counts as 0. ``corrected`` has images in [0, 1], LPIPS
            in [-1, 1], searches the flow in the photographs, moves only pixels that the correspondence calls visible,
            and averages RMSE over the pixels where they land. ``warp_coverage_*`` is their share.
        weights: LPIPS'; ``auto`` falls back to ST-LPIPS (``warp_st_lpips_*``) or a stand-in, with a warning, where the
            published ones are missing.

    Example:
        >>> from anystyle.testing.toy.correspondence import ToyCorrespondence
        >>> frames = torch.arange(8).view(1, 8, 1, 1, 1) * torch.full((1, 8, 3, 32, 32), 0.1)  # each 0.1 brighter
        >>> still = Cameras(torch.eye(4).repeat(1, 8, 1, 1), torch.eye(3).repeat(1, 8, 1, 1), (32, 32))
        >>> metric = WarpConsistency(correspondence=ToyCorrespondence(), variant="corrected", weights="stand_in")
        >>> metric.update(frames, frames, cameras=still, depth=torch.ones(1, 8, 32, 32))
        >>> print(*(f"{metric.compute()[f'warp_rmse_{reach}']:.3f}" for reach in ("short", "long")))
        0.100 0.700
    """

    better: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(("warp_rmse_short", "warp_lpips_short", "warp_rmse_long", "warp_lpips_long"), "lower"),
        **dict.fromkeys(("warp_coverage_short", "warp_coverage_long"), "higher"),
    }
    takes = ("preds", "target", "cameras", "depth", "numbers")
    totals: Tensor
    rows: Tensor

    def __init__(
        self,
        *,
        correspondence: Correspondence,
        flow_from: Literal["stylized", "content"] | None = None,
        variant: Literal["reference", "corrected"] = "reference",
        weights: Weights = "auto",
    ) -> None:
        super().__init__()
        self.correspondence = correspondence
        self.reference = variant == "reference"
        self.flow_from = flow_from or ("stylized" if self.reference else "content")
        self.network = lpips.load("vgg", weights)
        self.name_after(self.network.name)
        self.declare(*correspondence.sources)
        distances = [f"warp_{self.network.name}_{name}" for name in RANGES]
        self.declare(*correspondence.sources, self.network.source, scores=distances)
        # The photographs' flows of each range, for the next style of the same scene.
        self._content_flows: dict[int, tuple[list[str], Flows]] = {}
        self.add_state("totals", torch.zeros(2, 3, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros(2, dtype=torch.long), dist_reduce_fx="sum")

    @accepts_tensors
    def update(self, comparison: Comparison) -> None:
        for index, gap in enumerate(RANGES.values()):
            for row, preds in enumerate(comparison.stylized):
                means = self._row_means(preds, comparison.neighbours(gap), self._flows(comparison, row, gap))
                if means is not None:
                    self.totals[index] += means
                    self.rows[index] += 1

    def compute(self) -> dict[str, Tensor]:
        scores: dict[str, Tensor] = {}
        for index, (name, gap) in enumerate(RANGES.items()):
            if int(self.rows[index]) == 0:
                warnings.warn(
                    f"warp_consistency: no scene with {gap + 1} frames of which the first and the last see each other; "
                    f"the {name} range's scores are nan",
                    stacklevel=2,
                )
            means = (self.totals[index] / self.rows[index]).float()  # nan where there is no row
            for kind, value in zip(("rmse", self.network.name, "coverage"), means, strict=True):
                scores[f"warp_{kind}_{name}"] = value
        return {name: scores[name] for name in self.better}

    def _flows(self, comparison: Comparison, row: int, gap: int) -> Flows:
        """The flows of the pairs of one row; those of photographs are kept for the next style of the scene."""
        images = (comparison.stylized if self.flow_from == "stylized" else comparison.content)[row]
        frames = _frames(comparison, row, preprocess.eight_bit(images) if self.reference else images)
        neighbours = comparison.neighbours(gap)
        if self.flow_from == "stylized":
            return self._searched(frames, neighbours)
        parts = (frames.images, frames.depth, frames.world_from_camera, frames.intrinsics)
        key = [str(neighbours), *(digest for tensor in parts if tensor is not None for digest in digests(tensor))]
        if gap not in self._content_flows or self._content_flows[gap][0] != key:
            self._content_flows[gap] = (key, self._searched(frames, neighbours))
        return self._content_flows[gap][1]

    def _searched(self, frames: Frames, neighbours: Neighbours) -> Flows:
        flows: Flows = []
        for first, second in _batches(frames.images, neighbours):
            source: Frames = frames.map(lambda tensor, batch=first: tensor[batch])
            target: Frames = frames.map(lambda tensor, batch=second: tensor[batch])
            where = f"the correspondence {type(self.correspondence).__name__}"
            sizes = dict(zip("MHW", source.images[:, 0].shape, strict=True))
            if self.reference:
                displacement = self.correspondence.displacement(source, target)
                check_tensor(displacement, Float[Tensor, "M 2 H W"], f"the displacement of {where}", **sizes)
                flows.append((displacement, None))
            else:
                flow = self.correspondence(source, target)
                check_value(flow, Flow, where, **sizes)
                flows.append((flow.displacement, flow.visible))
        return flows

    def _row_means(
        self, images: Float[Tensor, "V 3 H W"], neighbours: Neighbours, flows: Flows
    ) -> Float[Tensor, "3"] | None:
        """RMSE, LPIPS and coverage averaged over the pairs of one row; ``None`` where no pair sees anything."""
        images = preprocess.eight_bit(images) if self.reference else images
        values: list[Tensor] = []
        for (first, second), (displacement, visible) in zip(_batches(images, neighbours), flows, strict=True):
            source, target = images[first], images[second]
            if visible is None:
                warped = reference_warp(source, target, displacement)
                error = (warped.image - warped.target).square().mean((1, 2, 3)).sqrt() / 255
                # The published script hands images in [0, 255] to a network that takes 2x - 1 for x in [0, 1].
                distance = self.network((warped.image + 1) / 2, (warped.target + 1) / 2)
            else:
                warped = corrected_warp(source, target, displacement, visible)
                # Where nothing is seen, 0 / 0: such a pair is left out.
                squares = (warped.image - warped.target).square().sum((1, 2, 3))
                error = (squares / (3 * warped.seen.flatten(1).sum(1))).sqrt()
                distance = self.network(warped.image, warped.target)
            values.append(torch.stack([error, distance, warped.seen.float().mean((1, 2, 3))]))
        table = torch.cat(values, dim=1).double() if values else images.new_zeros(3, 0)
        table = table[:, table.isfinite().all(0)]
        return table.mean(1) if table.shape[1] else None


def reference_warp(
    source: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"], displacement: Float[Tensor, "M 2 H W"]
) -> Warped:
    """Warp frames in [0, 1] as the published script does; the result is in [0, 255]."""
    source, target = 255 * source, 255 * target
    splat = softmax_splat(source, displacement, _logits(source, target, displacement))
    # As published, black is taken for unseen.
    seen = splat.image.sum(1, keepdim=True) != 0
    return Warped(splat.image, target * seen, seen)


def corrected_warp(
    source: Float[Tensor, "M 3 H W"],
    target: Float[Tensor, "M 3 H W"],
    displacement: Float[Tensor, "M 2 H W"],
    visible: Bool[Tensor, "M H W"],
) -> Warped:
    """Warp those pixels of frames in [0, 1] that are visible in the target."""
    logits = _logits(source, target, displacement)
    # Pixels without a finite displacement are left out.
    displacement = torch.where(visible[:, None], displacement, torch.nan)
    seen = softmax_splat(torch.ones_like(logits), displacement, torch.zeros_like(logits)).weight >= MIN_WEIGHT
    # The constant of 1e-7 in the sum is negligible beside weights of at least exp(-10) / 2.
    return Warped(softmax_splat(source, displacement, logits).image * seen, target * seen, seen)


def _logits(source: Tensor, target: Tensor, displacement: Tensor) -> Float[Tensor, "M 1 H W"]:
    difference = (source - backward_warp(target, displacement)).abs().mean(1, keepdim=True)
    return (-MAX_LOGIT * difference).clamp(-MAX_LOGIT, MAX_LOGIT)


def _batches(images: Float[Tensor, "V 3 H W"], neighbours: Neighbours) -> list[tuple[Tensor, Tensor]]:
    """The indices of first and second frames of all pairs, in batches."""
    pairs = torch.tensor(neighbours, dtype=torch.long, device=images.device).reshape(-1, 2)
    return [(batch[:, 0], batch[:, 1]) for batch in pairs.split(batch_size(images)) if len(batch)]


def _frames(comparison: Comparison, row: int, images: Float[Tensor, "V 3 H W"]) -> Frames:
    cameras, depth = comparison.cameras, comparison.depth
    return Frames(
        images=images,
        depth=depth[row] if depth is not None else None,
        world_from_camera=cameras.world_from_camera[row] if cameras is not None else None,
        intrinsics=cameras.intrinsics[row] if cameras is not None else None,
    )
