"""Brightness: the smallest training of a backbone."""

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from anystyle.contracts import Backbone, SceneSource, StyleSource
from anystyle.training.contract import Training, required
from anystyle.training.data import Batch, SceneBatches


class ToyTraining(Training):
    """Teach a backbone the mean depth of each view, where the scenes know it.

    Args:
        backbone: What learns; the framework passes it.
        batch_size: Scenes a step.
        num_views: Views a scene.
        learning_rate: Of Adam.
    """

    def __init__(
        self, *, backbone: Backbone, batch_size: int = 2, num_views: int = 2, learning_rate: float = 1e-3
    ) -> None:
        super().__init__()
        self.backbone = backbone
        self.batch_size = batch_size
        self.num_views = num_views
        self.learning_rate = learning_rate

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> SceneBatches:
        """See :meth:`anystyle.training.contract.Training.batches`."""
        return SceneBatches(
            required(scenes, "scenes"),
            seed=seed,
            batch_size=self.batch_size,
            context_views=(self.num_views, self.num_views),
            spread="any",
            multiple=self.backbone.patch_size,
        )

    def exports(self) -> Mapping[str, nn.Module]:
        """See :meth:`anystyle.training.contract.Training.exports`."""
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
