"""Brightness: the smallest training of a backbone."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anystyle.contracts import Backbone, SceneSource, StyleSource
from anystyle.contracts.scene import required
from anystyle.contracts.training import Training
from anystyle.ranges import AtLeastOne, Positive
from anystyle.training.data import Batch, SceneBatches


class ToyTraining(Training):
    """Teach a backbone the mean depth of each view, where the scenes know it.

    Args:
        backbone: What learns; the framework passes it.
        batch_size: Scenes per step.
        learning_rate: Adam's.
    """

    needs = ("scenes",)

    def __init__(self, *, backbone: Backbone, batch_size: AtLeastOne = 2, learning_rate: Positive = 1e-3) -> None:
        super().__init__()
        self.backbone, self.batch_size, self.learning_rate = backbone, batch_size, learning_rate

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> SceneBatches:
        known, patch = required(scenes, "scenes"), self.backbone.patch_size
        return SceneBatches(
            known, seed=seed, batch_size=self.batch_size, context_views=(2, 2), spread="any", multiple=patch
        )

    def exports(self) -> Mapping[str, nn.Module]:
        return {"backbone": self.backbone}

    def training_step(self, batch: Batch, step: int) -> Tensor:
        """The squared error of the mean depth of each view."""
        if batch.views.depth is None:
            raise ValueError("the scenes do not know their depth; choose others with scenes=NAME")
        predicted = self.backbone.encode(batch.views).geometry.depth
        loss = (predicted.mean((-1, -2)) - batch.views.depth.mean((-1, -2))).square().mean()
        self.log("train/loss", loss, batch_size=self.batch_size, prog_bar=True)
        return loss

    def configure_optimizers(self) -> torch.optim.Optimizer:
        """Adam."""
        return torch.optim.Adam(self.backbone.parameters(), lr=self.learning_rate)
