"""Configurations of trainings that take a second."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

import torch
from omegaconf import DictConfig

from anystyle.registry.compose import compose

BACKBONE = (
    "backbone=anysplat_tiny", "weights.backbone=null", "backbone.resolution=28",
    "backbone.native_resolution=28", "backbone.dim=16", "backbone.embed_depth=1", "backbone.depth=4",
    "backbone.taps=[0,1,2,3]", "backbone.heads=2", "backbone.camera_heads=2", "backbone.depth_features=8",
    "backbone.depth_channels=[8,8,8,8]", "backbone.gaussian_features=16",
    "backbone.gaussian_channels=[8,8,8,8]", "backbone.gaussian_hidden=8", "renderer=cpu",
)  # fmt: skip
RUN = (
    "trainer.max_steps=6", "trainer.log_every_n_steps=1", "trainer.val_check_interval=1000", "name=test",
    "fast_dev_run=false",
)  # fmt: skip
SCENES = ("scenes=procedural", "scenes.size=28", "scenes.num_scenes=4", "scenes.samples=1")
RECONSTRUCTION = (
    *BACKBONE, *RUN, *SCENES, "training=reconstruction", "training.batch_size=2",
    "training.context_views=[2,3]", "training.render_every=2", "training.warmup=2", "loss=[]", "average=0.9",
)  # fmt: skip
STYLIZATION = (
    *BACKBONE, *RUN, *SCENES, "training=stylization", "style_encoder=tiny", "styles=procedural",
    "styles.size=28", "styles.num_styles=1", "training.batch_size=2", "training.context_views=[2,2]",
    "training.spread=any", "training.heights=null", "training.width=null", "training.flip=0.0",
    "training.pool=2", "training.cache_scenes=2", "training.learning_rate=0.0005", "training.warmup=1",
    "loss=[total_variation,edge_aware_smoothness,clip_directional]", "loss.clip_directional.size=null",
)  # fmt: skip


def configuration(overrides: Sequence[str], out: Path) -> DictConfig:
    """The configuration of ``anystyle train`` with these overrides, its results in ``out``."""
    return compose("train", [*overrides, f"out={out}"])


@cache
def parts(*overrides: str) -> tuple[Any, Any]:
    """A stylization training that is not trained, and its batches; tests share it."""
    from anystyle.training.run import make_data, make_training

    config = configuration((*STYLIZATION, *overrides), Path("unused"))
    torch.manual_seed(0)
    training = make_training(config)
    return training, make_data(config, training).train
