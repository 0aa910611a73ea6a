"""Choosing the reference view, ahead of the first attention across views."""

from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float, Int
from torch import Tensor

from anystyle.types import Tokens

Strategy = Literal["central", "saddle_balanced", "saddle_sim_range", "middle", "first"]
LEAST_VIEWS = 3
"""With fewer views the published strategies take the first."""
THUMBNAIL = 8
"""Side, in pixels, at which ``central`` compares photographs."""


def reference_view(
    images: Float[Tensor, "B V 3 H W"], tokens: Float[Tensor, "B V C"], strategy: Strategy
) -> Int[Tensor, " B"] | None:
    """The reference view of each scene; ``None`` where it is the first by definition.

    Args:
        images: sRGB in [0, 1].
        tokens: One per view.
        strategy: ``central``: the photograph that differs least from all others, whatever their order; the others are
            published for Depth Anything 3. ``saddle_balanced``: the view that is nearest to the middle of the range in
            similarity to the others, norm and spread of its token; ``saddle_sim_range``: one of the two views that are
            most similar, where rounding breaks the tie because self-similarity is set to 0; ``middle`` and ``first`` of
            the capture.
    """
    if strategy == "central":  # the medoid of thumbnails; where two are as near, the darker one
        small = F.adaptive_avg_pool2d(images.flatten(0, 1).float(), THUMBNAIL).flatten(1).unflatten(0, images.shape[:2])
        distance = torch.cdist(small, small, compute_mode="donot_use_mm_for_euclid_dist")
        return (distance.mean(-1) + 1e-3 * small.mean(-1)).argmin(-1)
    batch, views, _ = tokens.shape
    if views < LEAST_VIEWS or strategy == "first":
        return None
    if strategy == "middle":
        return torch.full((batch,), views // 2, dtype=torch.long, device=tokens.device)
    unit = F.normalize(tokens.float(), dim=-1)
    with torch.autocast(tokens.device.type, enabled=False):
        similarity = unit @ unit.mT - torch.eye(views, device=tokens.device)
    if strategy == "saddle_sim_range":
        return (similarity.amax(-1) - similarity.amin(-1)).argmax(-1)
    scores = torch.stack([similarity.sum(-1) / (views - 1), tokens.float().norm(dim=-1), unit.var(dim=-1)])
    low, high = scores.amin(-1, keepdim=True), scores.amax(-1, keepdim=True)
    return ((scores - low) / (high - low + 1e-8) - 0.5).abs().sum(0).argmin(-1)


def is_reference(tokens: Tokens) -> Bool[Tensor, "B V"]:
    """Whether a view is the reference of its scene."""
    batch, views = tokens.data.shape[:2]
    index = torch.arange(views, device=tokens.data.device).expand(batch, -1)
    return index == (0 if tokens.reference is None else tokens.reference[:, None])


def reference_first(reference: Int[Tensor, " B"], views: int) -> Int[Tensor, "B V"]:
    """The order in which the reference comes first and all others stay as they were."""
    index = torch.arange(views, device=reference.device).expand(len(reference), -1)
    return torch.where(index == reference[:, None], -1, index).argsort(dim=1, stable=True)


def in_order(data: Float[Tensor, "B V *rest"], order: Int[Tensor, "B V"]) -> Float[Tensor, "B V *rest"]:
    """The views in another order, scene by scene."""
    return data[torch.arange(len(data), device=data.device)[:, None], order]
