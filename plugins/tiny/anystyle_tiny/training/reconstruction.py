"""Training a backbone from scratch: depth, cameras and Gaussians from posed scenes with depth."""

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import kornia
import torch
import torch.nn.functional as F
import torch.utils._pytree as pytree
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Backbone, Renderer, SceneSource, StyleSource
from anystyle.contracts.scene import required
from anystyle.contracts.training import Training
from anystyle.ranges import AtLeastOne, Count, Positive
from anystyle.training.data import Batch, SceneBatches
from anystyle.training.optim import scheduled
from anystyle.types import Attributes, Cameras, Features, Gaussians, Geometry, Renders, Tokens, Views
from anystyle_backbones.aligner import Aligner
from anystyle_backbones.reference_view import in_order, reference_first
from anystyle_tiny.training.decay import decayed_groups
from anystyle_tiny.training.matches import FeatureProbes, correlation_loss, feature_dims, patch_matches
from anystyle_tiny.training.supervision import camera_loss, canonical, depth_loss, point_loss, transfer_loss

WEIGHTS = {
    "depth": 1.0, "camera": 1.0, "transfer": 1.0, "point": 0.5, "render": 5.0, "ssim": 0.2,
    "match": 0.1, "glide": 1.0, "locate": 1.0, "shift": 5.0, "correlation": 0.3,
}  # fmt: skip
"""Weights of the terms: depth; cameras by themselves and as points move; points; renders and their structure; what each
patch must predict: its match in the first view, the match's expected position, its own world point, its motion toward
the first view; and the matches of an :class:`~anystyle_backbones.aligner.Aligner`."""


class ReconstructionTraining(Training):
    """Train a backbone to predict depth, cameras and Gaussians.

    Scenes are in the frame of the view that the backbone sees the others from (``Tokens.reference``), scaled so that
    the mean distance of the points that the context views see is 1. Gaussians are placed and rendered with the true
    cameras, so that the rendering loss trains depth and appearance before the predicted cameras are good. Tapped
    features must predict matches between views, points and shifts through projections that are not saved, and the
    matches of a backbone that aligns its cameras are supervised.

    Args:
        batch_size: Scenes per step over all processes.
        context_views: Least and greatest number of context views.
        view_power: Numbers of views are drawn in proportion to this power of themselves.
        target_views: Number of additional views for the rendering loss.
        heights: Least and greatest image height; ``None`` leaves images as they are.
        learning_rate: Learning rate of AdamW at the end of the warm-up.
        warmup: Steps of the warm-up.
        weight_decay: Weight decay of matrices.
        predicted_camera_weight: Factor of the rendering terms for a context view rendered at its predicted camera, as
            AnySplat is trained (arXiv 2505.23716); 0 renders none.
        render_every: Steps between two with renders.
        render_scenes: Number of scenes of the batch that are rendered: the target views and one context view each.
    """

    needs = ("scenes",)

    def __init__(
        self,
        *,
        backbone: Backbone,
        renderer: Renderer,
        batch_size: AtLeastOne = 8,
        context_views: Sequence[int] = (2, 4),
        view_power: float = 0.0,
        target_views: Count = 1,
        heights: Sequence[int] | None = None,
        learning_rate: Positive = 1e-3,
        warmup: Count = 200,
        weight_decay: float = 0.05,
        predicted_camera_weight: float = 0.0,
        render_every: AtLeastOne = 4,
        render_scenes: AtLeastOne = 4,
    ) -> None:
        super().__init__()
        self.backbone, self.renderer, self.target_views = backbone, renderer, target_views
        self.make_batches = partial(
            SceneBatches, batch_size=batch_size, context_views=context_views, view_power=view_power,
            target_views=target_views, spread="any", heights=heights, multiple=backbone.patch_size,
        )  # fmt: skip
        self.learning_rate, self.warmup, self.weight_decay = learning_rate, warmup, weight_decay
        self.render_every, self.render_scenes = render_every, render_scenes
        self.predicted_camera_weight = predicted_camera_weight
        predicted = {f"predicted_{name}": predicted_camera_weight * WEIGHTS[name] for name in ("render", "ssim")}
        self.weights = {**WEIGHTS, **predicted}
        self.probes = FeatureProbes(feature_dims(backbone))
        self._correlation: Float[Tensor, "B v r c r c"] | None = None
        for module in backbone.modules():
            if isinstance(module, Aligner):
                module.register_forward_pre_hook(self._keep)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"batch_size": 2, "context_views": (2, 2), "render_every": 1, "render_scenes": 1, "warmup": 1}

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> SceneBatches:
        return self.make_batches(required(scenes, "scenes"), seed=seed)

    def exports(self) -> Mapping[str, nn.Module]:
        return {"backbone": self.backbone}

    def training_step(self, batch: Batch, step: int) -> Tensor:
        backbone = self.backbone
        stem, rows = backbone.stem_of(batch.inputs), len(batch.keys)
        views, stem = reference_view_first(batch.views, stem)
        with self.exact():
            views = canonical(views, batch.context)
        inputs = views.select(list(range(batch.context)))
        features = backbone.aggregator(stem)
        with self.exact():
            features = {layer: tokens.to(torch.float32) for layer, tokens in features.items()}
            geometry = backbone.geometry_of(features, inputs)
        losses = self.geometry_losses(features, geometry, inputs)
        if self.global_step % self.render_every == 0:
            rendered = [step // self.render_every % batch.context, *range(batch.context, views.images.shape[1])]
            everything, count = (features, geometry, views), self.render_scenes
            some = pytree.tree_map_only(Tensor, lambda tensor: tensor[:count], everything)
            losses |= self.render_losses(some[0], some[1], some[2], rendered)
        total = self.total(losses)
        self.log("train/loss", total, batch_size=rows, prog_bar=True)
        self.log_dict({f"train/{name}": loss for name, loss in losses.items()}, batch_size=rows)
        return total

    def exact(self) -> AbstractContextManager[Any]:
        """Full precision for cameras and points, whatever the precision of the trainer."""
        return torch.autocast(self.device.type, enabled=False)

    def total(self, losses: Mapping[str, Float[Tensor, ""]]) -> Float[Tensor, ""]:
        return torch.stack([self.weights[name] * loss for name, loss in losses.items()]).sum()

    def geometry_losses(self, features: Features, geometry: Geometry, inputs: Views) -> dict[str, Float[Tensor, ""]]:
        """The unweighted terms without renders, of context views in the canonical frame; in full precision."""
        cameras, depth = inputs.cameras, inputs.depth
        assert cameras is not None and depth is not None
        with self.exact():
            losses = {
                "depth": depth_loss(geometry.depth, geometry.confidence, depth),
                "camera": camera_loss(geometry.cameras, cameras),
                "transfer": transfer_loss(geometry.cameras, cameras, depth),
                "point": point_loss(geometry, cameras, depth),
                **self.probes(features, patch_matches(cameras, depth, next(iter(features.values())).grid)),
            }
            correlation, self._correlation = self._correlation, None
            if correlation is not None:
                rows, columns = correlation.shape[-2:]
                losses["correlation"] = correlation_loss(correlation, patch_matches(cameras, depth, (rows, columns)))
            return losses

    def _keep(self, aligner: torch.nn.Module, inputs: tuple[Any, ...]) -> None:
        self._correlation = inputs[0] if aligner.training else None

    def render_losses(
        self, features: Features, geometry: Geometry, views: Views, rendered: Sequence[int]
    ) -> dict[str, Float[Tensor, ""]]:
        """The unweighted terms of renders, in the canonical frame.

        The views ``rendered`` are at their true cameras; the first, a context view, also at its predicted one.
        """
        context, targets = geometry.depth.shape[1], views.select(list(rendered))
        attributes = self.backbone.gaussian_head(features, views.images[:, :context]).to(torch.float32)
        assert views.cameras is not None and targets.cameras is not None
        with self.exact():
            gaussians = self.gaussians_at(attributes, geometry, views.cameras.select(slice(context)))
            losses = photometric(self.renderer(gaussians, targets.cameras), targets.images)
            if self.predicted_camera_weight:
                predicted = self.gaussians_at(attributes, geometry, geometry.cameras)
                renders = self.renderer(predicted, geometry.cameras.select([rendered[0]]))
                terms = photometric(renders, targets.images[:, :1])
                losses |= {f"predicted_{name}": loss for name, loss in terms.items()}
            return losses

    def gaussians_at(self, attributes: Attributes, geometry: Geometry, cameras: Cameras) -> Gaussians:
        geometry, adapter = geometry.seen_from(cameras), self.backbone.adapter
        return adapter(attributes, geometry, adapter.cluster(geometry, attributes))

    def errors(self, batch: Batch) -> dict[str, Float[Tensor, ""]]:
        views, _ = reference_view_first(batch.views, self.backbone.stem_of(batch.inputs))
        views = canonical(views, batch.context)
        inputs = views.select(list(range(batch.context)))
        scene = self.backbone.encode(inputs)
        errors = geometry_errors(scene.geometry, inputs)
        errors["loss"] = self.total(self.geometry_losses(scene.features, scene.geometry, inputs))
        assert views.cameras is not None and inputs.cameras is not None
        renders = self.renderer(self.gaussians_at(scene.attributes, scene.geometry, inputs.cameras), views.cameras)
        by_view = psnr(renders.color, views.images)
        errors["psnr_input_true_cameras"] = by_view[:, : batch.context].mean()
        if self.target_views:
            errors["psnr_novel_true_cameras"] = by_view[:, batch.context :].mean()
        gaussians = self.backbone.adapter(scene.attributes, scene.geometry, scene.clusters)
        renders = self.renderer(gaussians, scene.geometry.cameras)
        errors["psnr_input_predicted_cameras"] = psnr(renders.color, inputs.images).mean()
        return errors

    def validation_step(self, batch: Batch, step: int) -> None:
        with self.exact():
            errors = self.errors(batch)
        self.log_dict({f"val/{name}": value for name, value in errors.items()}, batch_size=len(batch.keys))

    def configure_optimizers(self) -> Any:
        groups = decayed_groups([self], lr=self.learning_rate, weight_decay=self.weight_decay)
        optimizer, total = torch.optim.AdamW(groups, betas=(0.9, 0.98)), self.trainer.max_steps - self.warmup
        return scheduled(optimizer, total=total, warmup=self.warmup, floor=0.01 * self.learning_rate)


def reference_view_first(views: Views, stem: Tokens) -> tuple[Views, Tokens]:
    """Views, and the tokens of the context views, with the view first that the others are seen from."""
    if stem.reference is None:
        return views, stem
    count, total = stem.data.shape[1], views.images.shape[1]
    order = reference_first(stem.reference, count)
    targets = torch.arange(count, total, device=order.device).expand(len(order), -1)
    whole = torch.cat([order, targets], dim=1)
    data, reference = in_order(stem.data, order), torch.zeros_like(stem.reference)
    return views.map(lambda tensor: in_order(tensor, whole)), replace(stem, data=data, reference=reference)


def photometric(renders: Renders, images: Float[Tensor, "B V 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Squared error, and structural dissimilarity in [0, 1]."""
    color, target = renders.color.flatten(0, 1), images.flatten(0, 1)
    ssim = kornia.metrics.ssim(color, target, window_size=7).mean()
    return {"render": F.mse_loss(color, target), "ssim": (1 - ssim) / 2}


def psnr(color: Float[Tensor, "B V 3 H W"], target: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V"]:
    """Peak signal-to-noise ratio of each view in decibels."""
    return -10 * (color - target).square().mean((2, 3, 4)).clamp_min(1e-10).log10()


def geometry_errors(geometry: Geometry, views: Views) -> dict[str, Float[Tensor, ""]]:
    """Errors of depth (relative, after one median scale a scene) and of cameras relative to the first view.

    Rotations and the directions of translations are compared pair by pair with the first view, in degrees; medians.
    """
    assert views.cameras is not None and views.depth is not None
    known = views.depth > 0
    ratio = torch.where(known, views.depth / geometry.depth.clamp_min(1e-6), torch.nan)
    # The lower median of known pixels, as torch.nanmedian's, which has no deterministic kernel for CUDA.
    middle = (known.flatten(1).sum(1) - 1).clamp_min(0) // 2
    scale = ratio.flatten(1).sort(1).values.gather(1, middle[:, None])[..., None, None]
    relative = ((geometry.depth * scale - views.depth).abs() / views.depth.clamp_min(1e-6))[known].mean()
    predicted = geometry.cameras.camera_from_world[:, :1] @ geometry.cameras.world_from_camera[:, 1:]
    true = views.cameras.camera_from_world[:, :1] @ views.cameras.world_from_camera[:, 1:]
    errors = {"depth_abs_rel": relative}
    if predicted.shape[1]:
        rotation = predicted[..., :3, :3].mT @ true[..., :3, :3]
        cosine = (rotation.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
        direction = F.cosine_similarity(predicted[..., :3, 3], true[..., :3, 3], dim=-1)
        errors["rotation_error_median_deg"] = cosine.clamp(-1, 1).acos().rad2deg().median()
        errors["translation_direction_error_median_deg"] = direction.clamp(-1, 1).acos().rad2deg().median()
    return errors
