"""RAFT: optical flow by the network of the published consistency scripts."""

import logging
from pathlib import Path
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Correspondence
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne
from anystyle.types import Flow, Frames, Source
from anystyle.vision.feature_cache import CACHE
from anystyle.vision.weights import Weights, locate, published
from anystyle_metrics.optical_flow import network
from anystyle_metrics.optical_flow.matching import match
from anystyle_metrics.optical_flow.visibility import cycle_visible, inside

log = logging.getLogger(__name__)

MAX_VOLUME = 1 << 29  # bytes that the correlation volumes of a batch of pairs may take


class Raft(Correspondence):
    """Optical flow of RAFT (Teed and Deng 2020), ``things`` weights, 32 iterations, as published.

    Frames are padded by their border to multiples of 8; smaller ones than 128 pixels a side to 128, which is logged:
    the published network gives no numbers there.

    Args:
        checkpoint: Which published weights: the original's or torchvision's.
        iterations: Number of updates.
        visibility: With ``cycle`` a pixel is visible if the flow back returns it to its start, at twice the cost; with
            ``frame`` if it stays in the frame, which suffices where visibility is not used.
        weights: ``auto`` falls back to a search in windows, with a warning, where the weights are missing.
    """

    def __init__(
        self,
        *,
        checkpoint: Literal["raft_things", "raft_large"] = "raft_things",
        iterations: AtLeastOne = 32,
        visibility: Literal["cycle", "frame"] = "cycle",
        weights: Weights = "auto",
    ) -> None:
        file = locate(checkpoint, weights)
        self.network = None if file is None else network.load(checkpoint, file)
        source = Source(checkpoint, stand_in="window_matching") if file is None else published(checkpoint, file)
        self.sources = (source,)
        self.iterations = iterations
        self.cycle = visibility == "cycle"

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"weights": "stand_in"}

    @torch.no_grad()
    def __call__(self, source: Frames, target: Frames) -> Flow:
        forward = self.displacement(source, target)
        # The features of a frame are computed once for both directions.
        visible = cycle_visible(forward, self.displacement(target, source)) if self.cycle else inside(forward)
        return Flow(forward, visible)

    @torch.no_grad()
    def displacement(self, source: Frames, target: Frames) -> Float[Tensor, "M 2 H W"]:
        """The flow alone, at half the cost of one with its visibility by cycle consistency."""
        if source.images.shape != target.images.shape:
            raise UserError(
                f"frames are {list(source.images.shape)} and {list(target.images.shape)}; flow needs pairs of one size"
            )
        height, width = source.images.shape[-2:]
        first, second = padded(source.images), padded(target.images)
        batch_size = max(1, MAX_VOLUME // (first.shape[-1] * first.shape[-2] // 64) ** 2 // 6)
        batches = zip(first.split(batch_size), second.split(batch_size), strict=True)
        return torch.cat([self._flow(*batch) for batch in batches])[..., :height, :width]

    def _flow(self, source: Tensor, target: Tensor) -> Tensor:
        raft = self.network
        if raft is None:
            return match(source, target)
        raft.to(source)
        identity = self.sources[0].identity
        frames = torch.cat([source, target])
        features = CACHE.features(frames, ("raft", identity), lambda images: [raft.describe(images)])[0].chunk(2)
        context = CACHE.features(source, ("raft context", identity), lambda images: list(raft.context(images)))
        return raft.flow(features[0], features[1], context, self.iterations)


def padded(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 h w"]:
    """Images continued by their border at the right and below, to what RAFT takes."""
    height, width = images.shape[-2:]
    if min(height, width) < network.SMALLEST:
        told = "frames of %dx%d pixels are padded to %d: RAFT has no numbers for smaller ones, and its flow near the "
        log.warning(told + "border is a guess", height, width, network.SMALLEST)
    below = max(network.SMALLEST, -(-height // 8) * 8) - height
    right = max(network.SMALLEST, -(-width // 8) * 8) - width
    return F.pad(images, (0, right, 0, below), mode="replicate") if below or right else images
