"""MEt3R with known geometry: whether neighbouring views show the same features at the same points."""

from collections.abc import Mapping
from typing import ClassVar, NamedTuple

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.correspondences.rendered_depth import RenderedDepth
from anystyle.geometry.warp import pixels
from anystyle.metrics.base import NetworkMetric, RowMean
from anystyle.types import Comparison, Frames
from anystyle.vision.feature_cache import batch_size, digests
from anystyle.vision.weights import Weights
from anystyle_metrics import dino

SHORT_SIDE, MULTIPLE = 256, 16  # pixels of the images that the network sees, MEt3R's, and of a patch
STEP = 4  # every fourth row and column of pixels is compared: features have less detail still


class Matches(NamedTuple):
    """Where pixels of views are seen in other views: coordinates in [-1, 1] in both, and whether they are seen."""

    here: Float[Tensor, "M h w 2"]
    there: Float[Tensor, "M h w 2"]
    seen: Bool[Tensor, "M h w"]


class Met3rDepth(NetworkMetric, RowMean):
    """One less the cosine of features of points that two neighbouring views see (after MEt3R, Asim et al., CVPR 2025).

    ``1 - (S(a, b) + S(b, a)) / 2`` in [0, 2] (arXiv 2501.06336, section 3): ``S(a, b)`` is the mean cosine of the
    features of ``a`` and of those of ``b`` warped into it, over the pixels of ``a`` that ``b`` sees. Views are paired
    with the next of their sequence. Two things differ from the publication, so that scores cannot be compared with it:
    pixels correspond by the comparison's depth and cameras and not by DUSt3R, and DINO's features (ViT-S/16, last
    layer) are interpolated bilinearly and not by FeatUp. Rows without depth or cameras, or without two views that
    follow each other, are left out.

    The stand-in has the activations of EfficientNet-Lite0's block 5.

    Args:
        weights: ``auto`` falls back to the stand-in, with a warning, where the published ones are missing.

    Example:
        >>> from anystyle.types import Cameras
        >>> views = torch.rand(1, 1, 3, 64, 64).expand(1, 2, 3, 64, 64)
        >>> intrinsics = torch.tensor([[64.0, 0, 32], [0, 64, 32], [0, 0, 1]]).repeat(1, 2, 1, 1)
        >>> cameras = Cameras(torch.eye(4).repeat(1, 2, 1, 1), intrinsics, (64, 64))
        >>> score = Met3rDepth(weights="stand_in")(views, cameras=cameras, depth=torch.ones(1, 2, 64, 64))
        >>> round(float(score), 3)
        0.0
    """

    better: ClassVar[Mapping[str, str]] = {"met3r_depth": "lower"}
    takes = ("preds", "cameras", "depth", "numbers")
    lacking: ClassVar[str] = "no two views with depth and cameras that see the same (folders give both by --depth)"

    def __init__(self, *, weights: Weights = "auto") -> None:
        super().__init__()
        self.network, source = dino.load("dino_vits16", weights)
        self.declare(source)
        self._correspondence = RenderedDepth()
        self._matches: tuple[list[str], list[Matches]] = ([], [])  # the last scene's, for its next style

    def of_rows(self, comparison: Comparison) -> Float[Tensor, " R"]:
        depth, cameras = comparison.depth, comparison.cameras
        neighbours = comparison.neighbours()
        if depth is None or cameras is None or not neighbours:
            return torch.zeros(0, dtype=torch.float64, device=comparison.stylized.device)
        rows = zip(comparison.stylized, depth, cameras.world_from_camera, cameras.intrinsics, strict=True)
        first, second = torch.tensor(neighbours).unbind(1)
        return torch.stack([self._of_row(Frames(*row), first, second) for row in rows])

    def _of_row(self, frames: Frames, first: Int[Tensor, " N"], second: Int[Tensor, " N"]) -> Float[Tensor, ""]:
        features = self._features(frames.images)
        matches = zip(((first, second), (second, first)), self._both_ways(frames, first, second), strict=True)
        similarities = [similarity(features[one], features[other], match) for (one, other), match in matches]
        return 1 - torch.stack(similarities).double().mean(0).nanmean()

    def _features(self, images: Float[Tensor, "V 3 H W"]) -> Float[Tensor, "V C h w"]:
        height, width = images.shape[-2:]
        size = [max(1, round(side * SHORT_SIDE / min(height, width) / MULTIPLE)) * MULTIPLE for side in (height, width)]
        images = F.interpolate(images, size=size, mode="bicubic", antialias=True).clamp(0, 1)
        return torch.cat([self.network.maps(batch) for batch in images.split(batch_size(images))])

    def _both_ways(self, frames: Frames, first: Int[Tensor, " N"], second: Int[Tensor, " N"]) -> list[Matches]:
        known = (frames.depth, frames.world_from_camera, frames.intrinsics)
        key = [digest for tensor in known if tensor is not None for digest in digests(tensor)]
        key.append(str((first.tolist(), second.tolist())))
        if key != self._matches[0]:
            source: Frames = frames.map(lambda tensor: tensor[first])
            target: Frames = frames.map(lambda tensor: tensor[second])
            self._matches = (key, [self._match(source, target), self._match(target, source)])
        return self._matches[1]

    def _match(self, source: Frames, target: Frames) -> Matches:
        flow = self._correspondence(source, target)
        here = (pixels(flow.displacement) + 0.5).expand_as(flow.displacement)
        sampled = (slice(None), slice(STEP // 2, None, STEP), slice(STEP // 2, None, STEP))
        size = here.new_tensor(here.shape[:1:-1])
        here, there = (
            2 * places.permute(0, 2, 3, 1)[sampled] / size - 1 for places in (here, here + flow.displacement)
        )
        return Matches(here, there, flow.visible[sampled])


def similarity(
    source: Float[Tensor, "M C h w"], target: Float[Tensor, "M C h w"], matches: Matches
) -> Float[Tensor, " M"]:
    """The mean cosine of features at pixels of the source that the target sees; ``nan`` where it sees none."""
    here, there = (
        F.grid_sample(features, places, padding_mode="border", align_corners=False)
        for features, places in ((source, matches.here), (target, matches.there))
    )
    cosines = F.cosine_similarity(here, there, dim=1)
    return (cosines * matches.seen).sum((1, 2)) / matches.seen.sum((1, 2))
