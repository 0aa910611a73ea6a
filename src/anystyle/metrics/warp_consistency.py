"""Warp consistency: whether a stylized frame, moved along the optical flow, looks like a later stylized frame."""

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar, Literal, NamedTuple

import torch
from jaxtyping import Bool, Float
from torch import Tensor

from anystyle.contracts import Correspondence, Metric
from anystyle.geometry.warp import backward_warp, softmax_splat
from anystyle.metrics._pairs import checked
from anystyle.perception import lpips, pictures
from anystyle.perception.memo import batch_of, fingerprints
from anystyle.perception.sources import Weights, checksums, stand_ins
from anystyle.types import Comparison, Frames

RANGES = {"short": 1, "long": 7}
"""How many frames lie between the frames of a pair."""

SATURATED = 10.0
"""Logits of the splatting are kept within this bound, as published."""

MIN_WEIGHT = 0.5
"""Of a corrected splat: how much of a pixel must have been landed on for it to count."""


Flows = list[tuple[Tensor, Tensor | None]]
"""Displacement and visibility of some pairs, in parts."""


class Warped(NamedTuple):
    """A source frame as seen from the target.

    Args:
        image: The moved source; 0 where nothing landed.
        target: The target frame; 0 likewise.
        seen: Where something landed.
    """

    image: Float[Tensor, "M 3 H W"]
    target: Float[Tensor, "M 3 H W"]
    seen: Bool[Tensor, "M 1 H W"]


class WarpConsistency(Metric):
    """Masked RMSE and LPIPS of neighbouring frames (t, t+1) and distant ones (t, t+7), as Stylos and StyleGaussian do.

    A frame is moved along the flow by softmax splatting and compared with the frame where it should have come from.
    Each row counts as the mean of its pairs; rows are averaged.

    Args:
        correspondence: The flow; the framework passes the one that is configured.
        flow_from: ``stylized`` frames, as published; or the ``content`` frames, whose flow a style cannot disturb and
            which is computed once for all styles. ``None`` takes the variant's: ``stylized`` in ``reference``,
            ``content`` in ``corrected``.
        variant: ``reference`` is the published script: images in [0, 255] for LPIPS and for the splatting's logits,
            which saturate; RMSE over all pixels, so that a hole is no error. ``corrected`` has images in [0, 1], LPIPS
            in [-1, 1], searches the flow in the photographs, moves only pixels that the correspondence calls visible,
            and averages RMSE over the pixels where they land. ``warp_coverage_*`` is their share.
        weights: Of LPIPS; ``auto`` takes a stand-in where the published ones are missing, and says so.
    """

    better: ClassVar[Mapping[str, str]] = {
        "warp_rmse_short": "lower",
        "warp_lpips_short": "lower",
        "warp_rmse_long": "lower",
        "warp_lpips_long": "lower",
        "warp_coverage_short": "higher",
        "warp_coverage_long": "higher",
    }
    is_differentiable = False
    full_state_update = False
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
        self._kept: dict[int, tuple[tuple[str, ...], Flows]] = {}
        self.network = lpips.load("vgg", weights)
        every = (*correspondence.sources, self.network.source)
        self.stand_ins = {
            **stand_ins(self.better, *correspondence.sources),
            **stand_ins(("warp_lpips_short", "warp_lpips_long"), *every),
        }
        self.weights = checksums(*every)
        self.add_state("totals", torch.zeros(2, 3, dtype=torch.float64), dist_reduce_fx="sum")
        self.add_state("rows", torch.zeros(2, dtype=torch.long), dist_reduce_fx="sum")

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """Stand-ins: quick, and the same everywhere."""
        return {"weights": "stand_in"}

    @torch.no_grad()
    def update(self, comparison: Comparison) -> None:
        """See :meth:`anystyle.contracts.Metric.update`; views are the frames, in their order."""
        checked(comparison)
        for place, gap in enumerate(RANGES.values()):
            for row in range(comparison.content.shape[0]):
                found = self._row(comparison.stylized[row], gap, self._flows(comparison, row, gap))
                if found is not None:
                    self.totals[place] += found
                    self.rows[place] += 1

    def compute(self) -> dict[str, Tensor]:
        """See :meth:`anystyle.contracts.Metric.compute`; ``nan`` where no row had frames enough."""
        figures: dict[str, Tensor] = {}
        for place, (name, gap) in enumerate(RANGES.items()):
            rows = self.rows[place]
            if int(rows) == 0:
                warnings.warn(
                    f"warp_consistency: no scene with {gap + 1} frames that see each other; "
                    f"the {name} range's figures are nan",
                    stacklevel=2,
                )
            # 0 / 0 is the nan that is meant.
            values = (self.totals[place] / rows).float()
            for kind, value in zip(("rmse", "lpips", "coverage"), values, strict=True):
                figures[f"warp_{kind}_{name}"] = value
        return {name: figures[name] for name in self.better}

    def _flows(self, comparison: Comparison, row: int, gap: int) -> Flows:
        """Displacement and visibility, where that is asked for, of the pairs of one row, in parts.

        The photographs' are kept for the next style of the same scene.
        """
        images = (comparison.stylized if self.flow_from == "stylized" else comparison.content)[row]
        if self.reference:
            images = pictures.eight_bit(images)
        frames = _frames(comparison, row, images)
        if self.flow_from == "stylized":
            return self._searched(frames, gap)
        known = (frames.images, frames.depth, frames.world_from_camera, frames.intrinsics)
        rows = [tensor.reshape(tensor.shape[0], 1, 1, -1) for tensor in known if tensor is not None]
        mark = tuple(mark for tensor in rows for mark in fingerprints(tensor))
        if self._kept.get(gap, ((), []))[0] != mark:
            self._kept[gap] = (mark, self._searched(frames, gap))
        return self._kept[gap][1]

    def _searched(self, frames: Frames, gap: int) -> Flows:
        found: Flows = []
        for part in _parts(frames.images, gap):
            source: Frames = frames.map(lambda tensor, p=part: tensor[p])
            target: Frames = frames.map(lambda tensor, p=part: tensor[p.start + gap : p.stop + gap])
            if self.reference:
                found.append((self.correspondence.displacement(source, target), None))
            else:
                flow = self.correspondence(source, target)
                found.append((flow.displacement, flow.visible))
        return found

    def _row(self, images: Float[Tensor, "V 3 H W"], gap: int, flows: Flows) -> Tensor | None:
        """RMSE, LPIPS and coverage, averaged over the pairs of one row; nothing where no pair sees anything."""
        values: list[Tensor] = []
        images = pictures.eight_bit(images) if self.reference else images
        for part, (displacement, visible) in zip(_parts(images, gap), flows, strict=True):
            source, target = images[part], images[part.start + gap : part.stop + gap]
            if visible is None:
                values.append(self._published(reference_warp(source, target, displacement)))
            else:
                values.append(self._meant(corrected_warp(source, target, displacement, visible)))
        table = torch.cat(values, dim=1).double() if values else images.new_zeros(3, 0)
        table = table[:, table.isfinite().all(0)]
        return table.mean(1) if table.shape[1] else None

    def _published(self, warped: Warped) -> Float[Tensor, "3 M"]:
        error = (warped.image - warped.target).square().mean((1, 2, 3)).sqrt() / 255
        # The published script hands images in [0, 255] to a network that takes 2x - 1 for x in [0, 1].
        distance = self.network((warped.image + 1) / 2, (warped.target + 1) / 2)
        return torch.stack([error, distance, _share(warped.seen)])

    def _meant(self, warped: Warped) -> Float[Tensor, "3 M"]:
        count = warped.seen.flatten(1).sum(1)
        # Where nothing is seen, 0 / 0: such a pair says nothing.
        error = ((warped.image - warped.target).square().sum((1, 2, 3)) / (3 * count)).sqrt()
        return torch.stack([error, self.network(warped.image, warped.target), _share(warped.seen)])


def reference_warp(
    source: Float[Tensor, "M 3 H W"], target: Float[Tensor, "M 3 H W"], displacement: Float[Tensor, "M 2 H W"]
) -> Warped:
    """Move frames in [0, 1] as the published script does; the result is in [0, 255]."""
    source, target = 255 * source, 255 * target
    splat = softmax_splat(source, displacement, _importance(source, target, displacement))
    # As published, black is taken for unseen.
    seen = splat.image.sum(1, keepdim=True) != 0
    return Warped(splat.image, target * seen, seen)


def corrected_warp(
    source: Float[Tensor, "M 3 H W"],
    target: Float[Tensor, "M 3 H W"],
    displacement: Float[Tensor, "M 2 H W"],
    visible: Bool[Tensor, "M H W"],
) -> Warped:
    """Move those pixels of frames in [0, 1] that are visible in the target."""
    importance = _importance(source, target, displacement)
    # What is not finite is not moved.
    displacement = torch.where(visible[:, None], displacement, torch.nan)
    landed = softmax_splat(torch.ones_like(importance), displacement, torch.zeros_like(importance)).weight
    seen = landed >= MIN_WEIGHT
    # The sum's constant of 1e-7 is nothing beside weights of at least exp(-10) / 2.
    image = softmax_splat(source, displacement, importance).image
    return Warped(image * seen, target * seen, seen)


def _importance(source: Tensor, target: Tensor, displacement: Tensor) -> Float[Tensor, "M 1 H W"]:
    difference = (source - backward_warp(target, displacement)).abs().mean(1, keepdim=True)
    return (-SATURATED * difference).clamp(-SATURATED, SATURATED)


def _share(seen: Bool[Tensor, "M 1 H W"]) -> Float[Tensor, " M"]:
    return seen.float().mean((1, 2, 3))


def _parts(images: Float[Tensor, "V 3 H W"], gap: int) -> list[slice]:
    count = batch_of(images)
    last = images.shape[0] - gap
    return [slice(start, min(start + count, last)) for start in range(0, last, count)]


def _frames(comparison: Comparison, row: int, images: Float[Tensor, "V 3 H W"]) -> Frames:
    cameras, depth = comparison.cameras, comparison.depth
    return Frames(
        images=images,
        depth=depth[row] if depth is not None else None,
        world_from_camera=cameras.world_from_camera[row] if cameras is not None else None,
        intrinsics=cameras.intrinsics[row] if cameras is not None else None,
    )
