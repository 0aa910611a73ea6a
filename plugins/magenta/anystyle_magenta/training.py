"""Training the text tower: captions to the style vectors that the prediction network sees in their pictures."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import SceneSource, StyleSource
from anystyle.contracts.training import Training, required
from anystyle.errors import UserError
from anystyle.io.cache import LRUCache
from anystyle.nn.words import with_made_up_word
from anystyle.ranges import AtLeastOne, Count, Positive
from anystyle.training.optim import decayed_adamw
from anystyle.training.sampling import generator
from anystyle.types import Value
from anystyle_magenta.networks import TextTower
from anystyle_magenta.style_encoder import MagentaEncoder


@dataclass(frozen=True)
class CaptionBatch(Value):
    """Captions, and the style vectors of their pictures."""

    texts: tuple[str, ...]
    vectors: Float[Tensor, "M 100"]

    @property
    def num_images(self) -> int:
        """Pictures."""
        return len(self.texts)


class CaptionBatches:
    """Batches of captions; a picture's style vector is computed when it is first drawn, and the picture forgotten."""

    def __init__(
        self, styles: StyleSource, encoder: MagentaEncoder, *, seed: int, batch_size: int, pool: int | None
    ) -> None:
        self.styles, self.encoder, self.seed, self.batch_size = styles, encoder, seed, batch_size
        self.pool = len(styles) if pool is None else min(pool, len(styles))
        if self.pool < batch_size:
            raise UserError(f"a batch of {batch_size} needs as many styles, and there are {self.pool}")
        self._rows: LRUCache[int, tuple[str, Tensor]] = LRUCache(self.pool)

    def batch(self, step: int, rank: int = 0, world: int = 1) -> CaptionBatch:
        """The rows of ``step`` that process ``rank`` of ``world`` works on."""
        rows = generator(self.seed, 16, step).choice(self.pool, self.batch_size, replace=False)[rank::world]
        return self.read(rows.tolist())

    def read(self, rows: Sequence[int]) -> CaptionBatch:
        """Captions and vectors of some styles."""
        texts, vectors = zip(*(self._rows.get(row, partial(self._row, row)) for row in rows), strict=True)
        return CaptionBatch(texts, torch.stack(vectors))

    @torch.no_grad()
    def _row(self, row: int) -> tuple[str, Tensor]:
        style = self.styles.read(row)
        if style.image is None or not style.text or not style.text[0]:
            raise UserError(f"style {row} lacks a picture or a caption; use styles=captioned")
        return style.text[0], self.encoder.embed_images(style.image)[0]


class CaptionTraining(Training):
    """Predict style vectors from captions, with the squared error.

    Args:
        style_encoder: Whose prediction network gives the targets; its text tower is trained from scratch.
        batch_size: Captions per step.
        pool: Styles to draw from; ``None`` means all there are.
        axes_on: How many styles the principal axes are computed from.
        learning_rate: Peak, of AdamW.
        warmup: Steps of the warm-up.
        weight_decay: Weight decay of matrices.
    """

    variance: Tensor

    needs = ("styles",)

    def __init__(
        self,
        *,
        style_encoder: MagentaEncoder,
        batch_size: AtLeastOne = 128,
        pool: AtLeastOne | None = None,
        axes_on: AtLeastOne = 1024,
        learning_rate: Positive = 2e-3,
        warmup: Count = 100,
        weight_decay: float = 0.02,
    ) -> None:
        super().__init__()
        self.encoder = style_encoder.requires_grad_(False).eval()
        self.tower = TextTower()
        self.register_buffer("variance", torch.ones(()))
        self.batch_size, self.pool, self.axes_on = batch_size, pool, axes_on
        self.learning_rate, self.warmup, self.weight_decay = learning_rate, warmup, weight_decay
        self.source: CaptionBatches | None = None

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"batch_size": 4, "pool": 8, "axes_on": 8, "warmup": 1}

    def exports(self) -> Mapping[str, nn.Module]:
        return {"text_tower": self.tower}

    def batches(self, scenes: SceneSource | None, styles: StyleSource | None, *, seed: int) -> CaptionBatches:
        self.source = CaptionBatches(
            required(styles, "styles"), self.encoder, seed=seed, batch_size=self.batch_size, pool=self.pool
        )
        return self.source

    def on_train_batch_start(self, batch: CaptionBatch, batch_idx: int) -> None:
        """Fix the principal axes before the first step."""
        if self.global_step == 0:
            assert self.source is not None
            examples = self.source.read(range(min(self.axes_on, self.source.pool)))
            self.tower.fit_axes(examples.vectors)
            self.variance.copy_(examples.vectors.var(0).sum())

    def training_step(self, batch: CaptionBatch, step: int) -> Tensor:
        """The squared error as a fraction of the variance."""
        predicted = self.tower([with_made_up_word(text) for text in batch.texts])
        loss = (predicted - batch.vectors).square().sum(1).mean() / self.variance
        self.log("train/loss", loss, batch_size=len(batch.texts), prog_bar=True)
        return loss

    def validation_step(self, batch: CaptionBatch, step: int) -> None:
        """Log how often a caption's nearest picture in the batch is its own, and the relative error."""
        predicted = self.tower(batch.texts)
        figures = {f"recall_at_{k}": recall(predicted, batch.vectors, k) for k in (1, 5)}
        figures["error"] = F.mse_loss(predicted, batch.vectors) / (batch.vectors - self.tower.mean).square().mean()
        self.log_dict({f"val/{name}": value for name, value in figures.items()}, batch_size=len(batch.texts))

    def configure_optimizers(self) -> Any:
        rate, decay, steps = self.learning_rate, self.weight_decay, self.trainer.max_steps
        return decayed_adamw(self.tower, lr=rate, weight_decay=decay, steps=steps, warmup=self.warmup)


def recall(predicted: Float[Tensor, "M D"], target: Float[Tensor, "M D"], k: int) -> Float[Tensor, ""]:
    """How often a prediction's own target is among the ``k`` of the largest cosine, each side about its own mean."""
    rows, columns = (F.normalize(side - side.mean(0), dim=-1) for side in (predicted, target))
    cosines = rows @ columns.T
    return (cosines > cosines.diagonal()[:, None]).sum(1).lt(k).float().mean()
