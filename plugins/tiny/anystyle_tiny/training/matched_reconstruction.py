"""Training a small backbone from nothing: reconstruction, and the matches between views taught directly."""

from collections.abc import Sequence
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import Backbone, Renderer
from anystyle.nn.aligner import Aligner
from anystyle.types import Cameras, Features
from anystyle_tiny.training.match_supervision import FeatureProbes, correlation_loss, patch_matches
from anystyle_tiny.training.reconstruction import ReconstructionTraining


class MatchedReconstruction(ReconstructionTraining):
    """Teach a backbone depth, cameras, Gaussians, and which patches of two views show the same point.

    Beside the terms of ``training=reconstruction``, tapped features must predict matches, points and shifts through
    projections that are not saved, and the matches of a backbone that aligns its cameras are supervised.

    Args:
        match_weight: Of the cross entropy of matching patches.
        glide_weight: Of the expected position of the match.
        locate_weight: Of each patch's world point.
        shift_weight: Of how each patch moves toward the first view.
        correlation_weight: Of the matches of an :class:`~anystyle.nn.aligner.Aligner`.
    """

    def __init__(
        self,
        *,
        backbone: Backbone,
        renderer: Renderer,
        batch_size: int = 8,
        context_views: Sequence[int] = (2, 4),
        view_power: float = 0.0,
        learning_rate: float = 1e-3,
        warmup: int = 200,
        predicted_camera_weight: float = 0.0,
        render_every: int = 4,
        render_scenes: int = 4,
        match_weight: float = 0.1,
        glide_weight: float = 1.0,
        locate_weight: float = 1.0,
        shift_weight: float = 5.0,
        correlation_weight: float = 0.3,
    ) -> None:
        super().__init__(
            backbone=backbone,
            renderer=renderer,
            batch_size=batch_size,
            context_views=context_views,
            view_power=view_power,
            learning_rate=learning_rate,
            warmup=warmup,
            predicted_camera_weight=predicted_camera_weight,
            render_every=render_every,
            render_scenes=render_scenes,
        )
        self.probes = FeatureProbes(feature_dims(backbone))
        self.weights |= {
            "match": match_weight,
            "glide": glide_weight,
            "locate": locate_weight,
            "shift": shift_weight,
            "correlation": correlation_weight,
        }
        self._correlation: Float[Tensor, "B v r c r c"] | None = None
        for module in backbone.modules():
            if isinstance(module, Aligner):
                module.register_forward_pre_hook(self._keep)

    def auxiliary_losses(
        self, features: Features, cameras: Cameras, depth: Float[Tensor, "B V H W"]
    ) -> dict[str, Float[Tensor, ""]]:
        losses = self.probes(features, patch_matches(cameras, depth, next(iter(features.values())).grid))
        correlation, self._correlation = self._correlation, None
        if correlation is not None:
            cells = (correlation.shape[-2], correlation.shape[-1])
            losses["correlation"] = correlation_loss(correlation, patch_matches(cameras, depth, cells))
        return losses

    def _keep(self, aligner: torch.nn.Module, inputs: tuple[Any, ...]) -> None:
        self._correlation = inputs[0] if aligner.training else None


@torch.no_grad()
def feature_dims(backbone: Backbone) -> dict[int, int]:
    """Channels of each tapped layer, found by a look at a black image of four patches."""
    side = 2 * backbone.patch_size
    reference = next(backbone.parameters())
    black = torch.zeros(1, 1, 3, side, side, device=reference.device, dtype=reference.dtype)
    features = backbone.aggregator(backbone.embedder(black))
    return {layer: tokens.data.shape[-1] for layer, tokens in features.items()}
