"""Training the judge of styles by contrast: pictures of styles, also on scenes, find their captions and the reverse."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.training.optim import decayed_groups, scheduled
from anystyle_tiny.judge import HeldoutEncoder
from anystyle_tiny.training.styles import StyleBatch, StyleTraining, TraitHeads, retrieval


class ContrastTraining(StyleTraining):
    """Bring pictures and captions of procedural styles together by contrast and by the names of what they are made of.

    A judge of stylized scenes must know a style where it lies on a scene, so some pictures are shown with the light and
    shade of a photograph, as a stylization of it would have.

    Args:
        style_encoder: What learns.
        batch_size: Styles a step.
        photos: Photographs a step, whose light falls on styles.
        pool: Styles to draw from, kept in memory; none means all there are.
        lit: Fraction of the pictures that have the light of a photograph.
        names_weight: Of naming pattern, scale and brushwork.
        learning_rate: Peak, of AdamW.
        warmup: Steps of the warm-up.
        weight_decay: Of matrices.
    """

    def __init__(
        self,
        *,
        style_encoder: HeldoutEncoder,
        batch_size: int = 128,
        photos: int = 16,
        pool: int | None = 12000,
        lit: float = 0.5,
        names_weight: float = 0.3,
        learning_rate: float = 2e-3,
        warmup: int = 50,
        weight_decay: float = 0.05,
    ) -> None:
        super().__init__()
        self.style_encoder = style_encoder
        self.batch_size, self.photos, self.pool, self.lit = batch_size, photos, pool, lit
        self.names_weight, self.learning_rate = names_weight, learning_rate
        self.warmup, self.weight_decay = warmup, weight_decay
        self.traits = TraitHeads(style_encoder.dim)
        self.log_temperature = nn.Parameter(torch.tensor(0.07).log())

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        """A few small pictures."""
        return {"batch_size": 4, "photos": 2, "pool": 8, "warmup": 1}

    def exports(self) -> Mapping[str, nn.Module]:
        """The encoder."""
        return {"style_encoder": self.style_encoder}

    def training_step(self, batch: StyleBatch, step: int) -> Tensor:
        """Symmetric cross-entropy of who belongs to whom, and what each must say of the style by itself."""
        pictures = self.style_encoder.embed_images(lit_by(batch.images, batch.photos, self.lit))
        captions = self.style_encoder.embed_texts(batch.texts)
        logits = pictures @ captions.T / self.log_temperature.exp().clamp(0.02, 1.0)
        index = torch.arange(len(logits), device=logits.device)
        contrast = (F.cross_entropy(logits, index) + F.cross_entropy(logits.T, index)) / 2
        names = [
            loss
            for vectors in (pictures, captions)
            for loss in self.traits.losses(vectors * self.style_encoder.dim**0.5, batch.traits).values()
        ]
        total = contrast + self.names_weight * torch.stack(names).sum()
        self.log("train/loss", total, batch_size=len(index), prog_bar=True)
        self.log("train/contrast", contrast, batch_size=len(index))
        return total

    def validation_step(self, batch: StyleBatch, step: int) -> None:
        """Log how often the right partner is found among the styles of a batch, plain and on scenes."""
        captions = self.style_encoder.embed_texts(batch.texts)
        figures: dict[str, Tensor] = {}
        for name, images in (("", batch.images), ("lit_", lit_by(batch.images, batch.photos, 1.0))):
            retrieved = retrieval(self.style_encoder.embed_images(images), captions)
            figures |= {f"{name}{key}": value for key, value in retrieved.items()}
        self.log_dict({f"val/{name}": value for name, value in figures.items()}, batch_size=len(captions))

    def configure_optimizers(self) -> Any:
        """AdamW with a warm-up and a cosine to 1 % of the rate."""
        return scheduled(
            torch.optim.AdamW(
                decayed_groups([self], lr=self.learning_rate, weight_decay=self.weight_decay), betas=(0.9, 0.98)
            ),
            total=self.trainer.max_steps - self.warmup,
            warmup=self.warmup,
            floor=0.01 * self.learning_rate,
        )


def lit_by(
    images: Float[Tensor, "M 3 H W"], photos: Float[Tensor, "P 3 H W"], chance: float
) -> Float[Tensor, "M 3 H W"]:
    """Pictures of which some, drawn at random, have the light and shade of a photograph drawn for each.

    Args:
        images: Of styles.
        photos: Of the same size; without any, the pictures stay as they are.
        chance: Of each picture to be lit.
    """
    if not len(photos):
        return images
    light = photos.mean(1, keepdim=True)
    light = light / light.mean((2, 3), keepdim=True).clamp_min(1e-3)
    count = len(images)
    chosen = light[torch.randint(len(photos), (count,), device=images.device)]
    lit, amount = torch.rand(2, count, 1, 1, 1, device=images.device)
    strength = (lit < chance) * amount
    return (images * chosen.clamp(0.2, 2.0) ** strength).clamp(0, 1)
