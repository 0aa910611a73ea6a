"""Training a backbone from scratch: depth, cameras and Gaussians from posed scenes with depth."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import kornia
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import Backbone, Renderer, SceneSource, StyleSource
from anystyle.training.contract import Training, required
from anystyle.training.data import Batch, SceneBatches
from anystyle.training.matching import FeatureProbes, patch_matches
from anystyle.training.optim import decayed_groups, scheduled
from anystyle.training.supervision import camera_loss, canonical, depth_loss, point_loss, transfer_loss
from anystyle.types import Cameras, Gaussians, Renders, Scene, Views


class ReconstructionTraining(Training):
    """Teach a backbone depth, cameras and Gaussians.

    Scenes are put into the frame of their first view, at a scale where the mean distance of what the context views
    see is 1. Gaussians are rendered from the true cameras, with the true cameras in the geometry too, so that the
    rendering loss teaches depth and appearance before cameras are any good.

    Args:
        backbone: What learns.
        renderer: Draws the Gaussians.
        batch_size: Scenes a step over all processes.
        context_views: Least and most views the network is given.
        target_views: Further views that only the rendering loss looks at.
        heights: Least and greatest image height; ``None`` leaves images as they are.
        learning_rate: Of AdamW, at the end of the warm-up.
        warmup: Steps of the warm-up.
        weight_decay: Of matrices.
        depth_weight: Of the depth loss.
        camera_weight: Of the errors of rotation, translation and focal length.
        transfer_weight: Of the camera errors measured on points.
        point_weight: Of the errors of world points.
        match_weight: Of matching patches across views, through a projection that is not kept.
        locate_weight: Of telling each patch's point in the first view's frame, likewise.
        render_weight: Of the squared error of renders.
        ssim_weight: Of their structural dissimilarity.
        render_after: The first step with renders.
    """

    def __init__(
        self,
        *,
        backbone: Backbone,
        renderer: Renderer,
        batch_size: int = 8,
        context_views: Sequence[int] = (2, 4),
        target_views: int = 2,
        heights: Sequence[int] | None = None,
        learning_rate: float = 1e-3,
        warmup: int = 200,
        weight_decay: float = 0.05,
        depth_weight: float = 1.0,
        camera_weight: float = 1.0,
        transfer_weight: float = 1.0,
        point_weight: float = 0.5,
        match_weight: float = 0.2,
        locate_weight: float = 1.0,
        render_weight: float = 5.0,
        ssim_weight: float = 0.2,
        render_after: int = 0,
    ) -> None:
        super().__init__()
        self.backbone = backbone
        self.renderer = renderer
        self.probes = FeatureProbes(feature_dims(backbone))
        self.batch_size, self.context_views, self.target_views = batch_size, context_views, target_views
        self.heights, self.warmup, self.render_after = heights, warmup, render_after
        self.learning_rate, self.weight_decay = learning_rate, weight_decay
        self.weights = {
            "depth": depth_weight,
            "camera": camera_weight,
            "transfer": transfer_weight,
            "point": point_weight,
            "match": match_weight,
            "locate": locate_weight,
            "render": render_weight,
            "ssim": ssim_weight,
        }

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> SceneBatches:
        """Scenes with context and target views."""
        return SceneBatches(
            required(scenes, "scenes"),
            seed=seed,
            batch_size=self.batch_size,
            context_views=self.context_views,
            view_power=0.0,
            target_views=self.target_views,
            spread="any",
            heights=self.heights,
            multiple=self.backbone.patch_size,
        )

    def exports(self) -> Mapping[str, nn.Module]:
        """The backbone."""
        return {"backbone": self.backbone}

    def training_step(self, batch: Batch, step: int) -> Tensor:
        """The weighted sum of all losses."""
        views = canonical(batch.views, batch.context)
        scene = self.backbone.encode(views.select(list(range(batch.context))))
        losses = self.losses(scene, views, rendering=self.global_step >= self.render_after)
        total = torch.stack([self.weights[name] * loss for name, loss in losses.items()]).sum()
        rows = len(batch.keys)
        self.log("train/loss", total, batch_size=rows, prog_bar=True)
        self.log_dict({f"train/{name}": loss for name, loss in losses.items()}, batch_size=rows)
        return total

    def losses(self, scene: Scene, views: Views, *, rendering: bool = True) -> dict[str, Float[Tensor, ""]]:
        """Every unweighted term.

        Args:
            scene: Of the context views.
            views: Context and target views in the canonical frame.
            rendering: Whether to render.
        """
        context = scene.views.images.shape[1]
        assert views.cameras is not None and views.depth is not None
        cameras, depth = views.cameras.select(slice(context)), views.depth[:, :context]
        geometry = scene.geometry
        grid = next(iter(scene.features.values())).grid
        matching, locating = self.probes(scene.features, patch_matches(cameras, depth, grid))
        losses = {
            "depth": depth_loss(geometry.depth, geometry.confidence, depth),
            "camera": camera_loss(geometry.cameras, cameras),
            "transfer": transfer_loss(geometry.cameras, cameras, depth),
            "point": point_loss(geometry, cameras, depth),
            "match": matching,
            "locate": locating,
        }
        if rendering:
            renders = self.renderer(self.gaussians_at(scene, cameras), views.cameras)
            losses |= photometric(renders, views.images)
        return losses

    def gaussians_at(self, scene: Scene, cameras: Cameras) -> Gaussians:
        """The scene's Gaussians as if its cameras were these."""
        geometry = replace(scene.geometry, cameras=cameras)
        adapter = self.backbone.adapter
        return adapter(scene.attributes, geometry, adapter.cluster(geometry, scene.attributes))

    def validation_step(self, batch: Batch, step: int) -> None:
        """Log how far depth, cameras and renders are off."""
        views = canonical(batch.views, batch.context)
        scene = self.backbone.encode(views.select(list(range(batch.context))))
        losses = self.losses(scene, views)
        total = torch.stack([self.weights[name] * loss for name, loss in losses.items()]).sum()
        assert views.cameras is not None and views.depth is not None
        rows = len(batch.keys)
        self.log("val/loss", total, batch_size=rows)
        found = geometry_errors(scene, views.select(list(range(batch.context))))
        true = self.renderer(self.gaussians_at(scene, views.cameras.select(slice(batch.context))), views.cameras)
        known = psnr(true.color, views.images)
        found["psnr_input_true_cameras"] = known[:, : batch.context].mean()
        if self.target_views:
            found["psnr_novel_true_cameras"] = known[:, batch.context :].mean()
        own = self.renderer(
            self.backbone.adapter(scene.attributes, scene.geometry, scene.clusters), scene.geometry.cameras
        )
        found["psnr_input_own_cameras"] = psnr(own.color, scene.views.images).mean()
        self.log_dict({f"val/{name}": value for name, value in found.items()}, batch_size=rows)

    def configure_optimizers(self) -> Any:
        """AdamW with a warm-up and a cosine to 1 % of the rate."""
        groups = decayed_groups([self.backbone, self.probes], lr=self.learning_rate, weight_decay=self.weight_decay)
        optimizer = torch.optim.AdamW(groups, betas=(0.9, 0.98))
        return scheduled(
            optimizer,
            total=self.trainer.max_steps - self.warmup,
            warmup=self.warmup,
            floor=0.01 * self.learning_rate,
        )


def photometric(renders: Renders, images: Float[Tensor, "B V 3 H W"]) -> dict[str, Float[Tensor, ""]]:
    """Squared error, and structural dissimilarity in [0, 1]."""
    drawn, seen = renders.color.flatten(0, 1), images.flatten(0, 1)
    alike = kornia.metrics.ssim(drawn, seen, window_size=7).mean()
    return {"render": F.mse_loss(drawn, seen), "ssim": (1 - alike) / 2}


def psnr(drawn: Float[Tensor, "B V 3 H W"], seen: Float[Tensor, "B V 3 H W"]) -> Float[Tensor, "B V"]:
    """Peak signal-to-noise ratio of each view in decibels."""
    return -10 * (drawn - seen).square().mean((2, 3, 4)).clamp_min(1e-10).log10()


def geometry_errors(scene: Scene, views: Views) -> dict[str, Float[Tensor, ""]]:
    """Errors of depth (relative, after one median scale a scene) and of cameras relative to the first view.

    Rotations and the directions of translations are compared pair by pair with the first view, in degrees; medians.
    """
    assert views.cameras is not None and views.depth is not None
    known = views.depth > 0
    ratio = torch.where(known, views.depth / scene.geometry.depth.clamp_min(1e-6), torch.nan)
    scale = ratio.flatten(1).nanmedian(dim=1).values[:, None, None, None]
    relative = ((scene.geometry.depth * scale - views.depth).abs() / views.depth.clamp_min(1e-6))[known].mean()
    found = scene.geometry.cameras.camera_from_world[:, :1] @ scene.geometry.cameras.world_from_camera[:, 1:]
    true = views.cameras.camera_from_world[:, :1] @ views.cameras.world_from_camera[:, 1:]
    errors = {"depth_abs_rel": relative}
    if found.shape[1]:
        turned = found[..., :3, :3].mT @ true[..., :3, :3]
        cosine = (turned.diagonal(dim1=-2, dim2=-1).sum(-1) - 1) / 2
        toward = F.cosine_similarity(found[..., :3, 3], true[..., :3, 3], dim=-1)
        errors["rotation_error_median_deg"] = cosine.clamp(-1, 1).acos().rad2deg().median()
        errors["translation_direction_error_median_deg"] = toward.clamp(-1, 1).acos().rad2deg().median()
    return errors


@torch.no_grad()
def feature_dims(backbone: Backbone) -> dict[int, int]:
    """Channels of each tapped layer, found by a look at a black image of four patches."""
    side = 2 * backbone.patch_size
    reference = next(backbone.parameters())
    black = torch.zeros(1, 1, 3, side, side, device=reference.device, dtype=reference.dtype)
    features = backbone.aggregator(backbone.embedder(black))
    return {layer: tokens.data.shape[-1] for layer, tokens in features.items()}
