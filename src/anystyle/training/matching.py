"""Auxiliary supervision of a backbone's features: which patches of two views show the same point, and where it lies.

A small network does not find poses from pose errors alone. What it must do on the way, match patches across views and
carry positions along the matches, is taught directly here, through projections that exist in training only.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor, nn

from anystyle.training.supervision import project
from anystyle.types import Cameras, Features, Geometry, Tokens


@dataclass(frozen=True)
class Matches:
    """What is known of patch centres.

    Args:
        points: World points of the patch centres.
        known: Whether a centre has a point.
        target: Of the patches of view i, the patch of view j that shows the same point.
        visible: Whether there is one: inside the image, and not hidden.
        first: Where the first view sees the point, in [-1, 1] over its image; may lie outside.
    """

    points: Float[Tensor, "B V P 3"]
    known: Bool[Tensor, "B V P"]
    target: Int[Tensor, "B V V P"]
    visible: Bool[Tensor, "B V V P"]
    first: Float[Tensor, "B V P 2"]


def patch_matches(
    cameras: Cameras, depth: Float[Tensor, "B V H W"], grid: tuple[int, int], *, tolerance: float = 0.05
) -> Matches:
    """Correspondences between the patches of all pairs of views.

    Args:
        cameras: True cameras.
        depth: True depth; 0 where it is not known.
        grid: Rows and columns of patches.
        tolerance: A point is hidden where the other view's depth differs from its own by more than this share.
    """
    height, width = cameras.size
    rows, columns = grid
    batch, count = depth.shape[:2]
    v = ((torch.arange(rows, device=depth.device) + 0.5) * height / rows).long()
    u = ((torch.arange(columns, device=depth.device) + 0.5) * width / columns).long()
    world = Geometry(cameras, depth, depth).points()[:, :, v][:, :, :, u].flatten(2, 3)
    known = (depth[:, :, v][:, :, :, u] > 0).flatten(2, 3)
    pixel, distance = project(cameras, world.flatten(1, 2))
    pixel = pixel.unflatten(2, (count, -1)).transpose(1, 2)  # B from to P 2
    distance = distance.unflatten(2, (count, -1)).transpose(1, 2)
    x, y = pixel[..., 0], pixel[..., 1]
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height) & (distance > 1e-3)
    column, row = x.clamp(0, width - 1).long(), y.clamp(0, height - 1).long()
    flat = depth.flatten(2)[:, None].expand(-1, count, -1, -1)
    seen = flat.gather(3, row * width + column)
    unhidden = (seen - distance).abs() < tolerance * distance.clamp_min(1e-3)
    target = (y * rows / height).clamp(0, rows - 1).long() * columns + (x * columns / width).clamp(
        0, columns - 1
    ).long()
    scale = depth.new_tensor([2 / width, 2 / height])
    return Matches(
        points=world,
        known=known,
        target=target,
        visible=inside & unhidden & known[:, :, None],
        first=(pixel[:, :, 0] * scale - 1).clamp(-2, 2),
    )


class FeatureProbes(nn.Module):
    """Projections of tapped features that must tell matches, points and positions in the first view.

    Args:
        dims: Channels of each tapped layer.
        descriptor: Channels in which patches are compared.
        temperature: Of the comparison.
    """

    def __init__(self, dims: Mapping[int, int], *, descriptor: int = 64, temperature: float = 0.07) -> None:
        super().__init__()
        self.temperature = temperature
        self.normal = nn.ModuleDict({str(layer): nn.LayerNorm(dim) for layer, dim in dims.items()})
        self.compare = nn.ModuleDict({str(layer): nn.Linear(dim, descriptor) for layer, dim in dims.items()})
        self.locate = nn.ModuleDict({str(layer): nn.Linear(dim, 5) for layer, dim in dims.items()})

    def forward(
        self, features: Features, matches: Matches
    ) -> tuple[Float[Tensor, ""], Float[Tensor, ""]]:
        """The loss of matching, and that of locating, each a mean over layers."""
        matching, locating = [], []
        for layer, tokens in features.items():
            patches = self.normal[str(layer)](in_input_order(tokens).patches)
            matching.append(self._matching(self.compare[str(layer)](patches), matches))
            locating.append(self._locating(self.locate[str(layer)](patches), matches))
        return torch.stack(matching).mean(), torch.stack(locating).mean()

    def _matching(self, descriptors: Float[Tensor, "B V P d"], matches: Matches) -> Tensor:
        unit = F.normalize(descriptors, dim=-1)
        alike = torch.einsum("bipd,bjqd->bijpq", unit, unit) / self.temperature
        count = unit.shape[1]
        pairs = ~torch.eye(count, dtype=torch.bool, device=unit.device)
        chosen = matches.visible & pairs[None, :, :, None]
        loss = F.cross_entropy(alike.flatten(0, 3), matches.target.flatten(), reduction="none")
        return (loss * chosen.flatten()).sum() / chosen.sum().clamp_min(1)

    def _locating(self, located: Float[Tensor, "B V P 5"], matches: Matches) -> Tensor:
        point = (located[..., :3] - matches.points).norm(dim=-1) / matches.points.norm(dim=-1).clamp_min(0.1)
        place = (located[..., 3:] - matches.first).abs().mean(-1)
        return ((point + place) * matches.known).sum() / matches.known.sum().clamp_min(1)


def in_input_order(tokens: Tokens) -> Tokens:
    """Tokens with the views in the order of the input, where a backbone reorders them."""
    if tokens.order is None:
        return tokens
    place = tokens.order.argsort(dim=1)[..., None, None].expand_as(tokens.data)
    return Tokens(data=tokens.data.gather(1, place), grid=tokens.grid, special=tokens.special)
