"""Matches between views, taught directly: a small network does not learn poses only from pose errors.

Matching patches across views, and localising them, is supervised through projections that exist in training only.
"""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from anystyle.contracts import Backbone
from anystyle.types import Cameras, Features, Geometry
from anystyle_tiny.training.supervision import masked_mean, project


@dataclass(frozen=True)
class PatchMatches:
    """Patch centres, their world points, and where the first view sees them."""

    points: Float[Tensor, "B V P 3"]
    known: Bool[Tensor, "B V P"]
    target: Int[Tensor, "B V P"]
    visible: Bool[Tensor, "B V P"]
    shift: Float[Tensor, "B V P 2"]
    centers: Float[Tensor, "P 2"]


def patch_matches(
    cameras: Cameras, depth: Float[Tensor, "B V H W"], grid: tuple[int, int], *, tolerance: float = 0.05
) -> PatchMatches:
    """Correspondences of the patches of all views with those of the first."""
    (height, width), (rows, columns) = cameras.size, grid
    v = ((torch.arange(rows, device=depth.device) + 0.5) * height / rows).long()
    u = ((torch.arange(columns, device=depth.device) + 0.5) * width / columns).long()
    world = Geometry(cameras, depth, depth).points()[:, :, v][:, :, :, u].flatten(2, 3)
    known = (depth[:, :, v][:, :, :, u] > 0).flatten(2, 3)
    seen_at = project(cameras.select([0]), world.flatten(1, 2))
    pixel, distance = (each[:, 0].unflatten(1, known.shape[1:]) for each in seen_at)
    x, y = pixel[..., 0], pixel[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (distance > 1e-3)
    column, row = x.clamp(0, width - 1).long(), y.clamp(0, height - 1).long()
    seen = depth[:, 0].flatten(1).gather(1, (row * width + column).flatten(1)).unflatten(1, known.shape[1:])
    unhidden = (seen - distance).abs() < tolerance * distance.clamp_min(1e-3)
    scale = depth.new_tensor([2 / width, 2 / height])
    centers = torch.cartesian_prod(v + 0.5, u + 0.5).flip(-1) * scale - 1
    return PatchMatches(
        points=world,
        known=known,
        target=row * rows // height * columns + column * columns // width,
        visible=inside & unhidden & known,
        shift=(pixel * scale - 1).clamp(-2, 2) - centers,
        centers=centers,
    )


class FeatureProbes(nn.Module):
    """Projections of tapped features that predict matches, points and shifts."""

    def __init__(self, dims: Mapping[int, int], *, descriptor: int = 64, temperature: float = 0.07) -> None:
        super().__init__()
        self.temperature = temperature
        self.normal = nn.ModuleDict({str(layer): nn.LayerNorm(dim) for layer, dim in dims.items()})
        self.compare = nn.ModuleDict({str(layer): nn.Linear(dim, descriptor) for layer, dim in dims.items()})
        self.locate = nn.ModuleDict({str(layer): nn.Linear(dim, 5) for layer, dim in dims.items()})

    def forward(self, features: Features, matches: PatchMatches) -> dict[str, Float[Tensor, ""]]:
        """Means over layers."""
        terms: dict[str, list[Tensor]] = defaultdict(list)
        others = matches.visible[:, 1:]
        for layer, tokens in features.items():
            patches = self.normal[str(layer)](tokens.patches.float())
            unit = F.normalize(self.compare[str(layer)](patches), dim=-1)
            alike = torch.einsum("bipd,bqd->bipq", unit[:, 1:], unit[:, 0]) / self.temperature  # B v P P
            entropy = F.cross_entropy(alike.movedim(-1, 1), matches.target[:, 1:], reduction="none")
            expected = alike.softmax(-1) @ matches.centers
            glide = (expected - (matches.centers + matches.shift[:, 1:])).abs().mean(-1)
            located = self.locate[str(layer)](patches)
            point = (located[..., :3] - matches.points).norm(dim=-1) / matches.points.norm(dim=-1).clamp_min(0.1)
            shift = (located[..., 3:] - matches.shift).abs().mean(-1)[:, 1:]
            terms["match"].append(masked_mean(entropy, others))
            terms["glide"].append(masked_mean(glide, others))
            terms["locate"].append(masked_mean(point, matches.known))
            terms["shift"].append(masked_mean(shift, matches.known[:, 1:]))
        return {name: torch.stack(values).mean() for name, values in terms.items()}


def correlation_loss(correlation: Float[Tensor, "B v r c r c"], matches: PatchMatches) -> Float[Tensor, ""]:
    """Cross entropy of a backbone's matches with the first view.

    The truth is spread over the four cells around it, as bilinear interpolation does, so that the expected position of
    a perfect match is exact.
    """
    rows, columns = correlation.shape[-2:]
    logits = correlation.flatten(4).flatten(2, 3)
    position = (matches.centers + matches.shift[:, 1:] + 1) / 2 * logits.new_tensor([columns, rows]) - 0.5
    left, top = position.floor().unbind(-1)
    log_probability = logits.log_softmax(-1)
    entropy = torch.zeros_like(left)
    for dx, dy in ((0, 0), (1, 0), (0, 1), (1, 1)):
        column, row = left + dx, top + dy
        weight = (1 - (position[..., 0] - column).abs()) * (1 - (position[..., 1] - row).abs())
        index = row.clamp(0, rows - 1) * columns + column.clamp(0, columns - 1)
        entropy = entropy - weight * log_probability.gather(-1, index.long()[..., None])[..., 0]
    return masked_mean(entropy, matches.visible[:, 1:])


@torch.no_grad()
def feature_dims(backbone: Backbone) -> dict[int, int]:
    """Channels of each tapped layer, found by a look at a black image of four patches."""
    side = 2 * backbone.patch_size
    reference = next(backbone.parameters())
    black = torch.zeros(1, 1, 3, side, side, device=reference.device, dtype=reference.dtype)
    return {layer: tokens.data.shape[-1] for layer, tokens in backbone.aggregator(backbone.embedder(black)).items()}
