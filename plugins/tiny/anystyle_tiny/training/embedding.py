"""Training the tiny style encoder: pictures of styles and their captions in one space."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.words import with_made_up_word
from anystyle.ranges import AtLeastOne, Count, Positive
from anystyle.training.optim import decayed_adamw
from anystyle.vision import networks
from anystyle_tiny.style_encoder import KNOTS, SIDE, Tiny, colors, shorter_side
from anystyle_tiny.training.styles import StyleBatch, StyleTraining, TraitHeads, retrieval


class EmbeddingTraining(StyleTraining):
    """Bring pictures and captions of procedural styles into one space in which patterns and palettes are plain to see.

    With only the contrastive loss colours dominate patterns, so pattern, scale and palette must also be predicted from
    the embeddings of both modalities; the palette by a linear map, so that mixtures of embeddings are mixtures of
    palettes. Part of the way through, centres and whitening are fixed, and training continues with them.

    Args:
        style_encoder: What learns.
        texture: The network of :func:`anystyle.vision.networks.load` whose convolutions are used, frozen;
            ``None`` takes random ones. Their features are computed once per picture.
        batch_size: Styles per step.
        photos: Photographs per step, which stand for no style.
        pool: Styles to draw from, kept in memory; none means all there are.
        feature_noise: Relative noise on cached features, instead of augmenting the pictures.
        names_weight: Weight of naming pattern, scale and brushwork.
        palette_weight: Weight of the palette, the squared error of the ramp over the variance of uniform colours.
        whiten_at: Where whitening is fixed, as a fraction of the training.
        whiten_on: How many styles it is computed from.
        learning_rate: Peak, of AdamW.
        warmup: Steps of the warm-up.
        weight_decay: Weight decay of matrices.
    """

    def __init__(
        self,
        *,
        style_encoder: Tiny,
        texture: str | None = "texture",
        batch_size: AtLeastOne = 192,
        photos: Count = 16,
        pool: AtLeastOne | None = 12000,
        feature_noise: float = 0.05,
        names_weight: float = 0.5,
        palette_weight: float = 40.0,
        whiten_at: float = 0.6,
        whiten_on: AtLeastOne = 2048,
        learning_rate: Positive = 2e-3,
        warmup: Count = 50,
        weight_decay: float = 0.05,
    ) -> None:
        super().__init__()
        self.style_encoder = style_encoder
        if texture is not None:
            style_encoder.image_tower.texture.load_state_dict(networks.load(texture).state_dict())
        style_encoder.image_tower.texture.requires_grad_(False)
        self.feature_noise = feature_noise
        self._known: dict[int, tuple[Tensor, Tensor]] = {}
        self.batch_size, self.photos, self.pool = batch_size, photos, pool
        self.names_weight, self.palette_weight = names_weight, palette_weight
        self.whiten_at, self.whiten_on = whiten_at, whiten_on
        self.learning_rate, self.warmup, self.weight_decay = learning_rate, warmup, weight_decay
        self.traits = TraitHeads(style_encoder.dim)
        self.log_temperature = nn.Parameter(torch.tensor(0.07).log())

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"texture": None, "batch_size": 4, "photos": 2, "pool": 8, "whiten_on": 8, "warmup": 1}

    def exports(self) -> Mapping[str, nn.Module]:
        return {"style_encoder": self.style_encoder}

    def on_train_batch_start(self, batch: StyleBatch, batch_idx: int) -> None:
        if self.global_step == int(self.whiten_at * self.trainer.max_steps):
            assert self.source is not None
            examples = self.source.examples(self.whiten_on)
            self.style_encoder.eval()
            self.style_encoder.whiten(examples.images, examples.texts)
            self.style_encoder.train()

    def training_step(self, batch: StyleBatch, step: int) -> Tensor:
        styles = len(batch.texts)
        images = torch.cat([batch.images, batch.photos])
        raw, ramps = self.known_pictures(images, batch.keys)
        pictures = self.style_encoder.from_image_tower(raw)
        captions = self.style_encoder.embed_texts([with_made_up_word(text) for text in batch.texts + batch.photo_texts])
        terms = {"contrast": self.contrast(pictures, captions, len(batch.photos))}
        for name, vectors in (("image", pictures), ("text", captions)):
            named = self.traits.losses(self.style_encoder.scaled(vectors[:styles]), batch.traits)
            terms[f"{name}_names"] = torch.stack([*named.values()]).sum()
            terms[f"{name}_palette"] = self.palette_error(vectors, ramps)
        weights = {"contrast": 1.0, "names": self.names_weight, "palette": self.palette_weight}
        total = torch.stack([weights[name.split("_")[-1]] * value for name, value in terms.items()]).sum()
        self.log("train/loss", total, batch_size=styles, prog_bar=True)
        self.log_dict({f"train/{name}": value for name, value in terms.items()}, batch_size=styles)
        return total

    def palette_error(self, vectors: Float[Tensor, "M D"], ramps: Float[Tensor, "M knots 3"]) -> Float[Tensor, ""]:
        """Squared error of the ramps that embeddings give back, over the variance of uniform colours."""
        target = F.adaptive_avg_pool1d(ramps.mT, KNOTS).mT
        return 12 * (self.style_encoder.palette(vectors) - target).square().mean()

    def known_pictures(
        self, images: Float[Tensor, "M 3 H W"], keys: tuple[int, ...]
    ) -> tuple[Float[Tensor, "M D"], Float[Tensor, "M knots 3"]]:
        """Raw vectors of the image tower, from cached textures and ramps; only its head is trained."""
        tower = self.style_encoder.image_tower
        with torch.no_grad():
            for key, image in zip(keys, images[:, None], strict=True):
                if key not in self._known:
                    # One by one, so that a picture's features do not depend on its batch.
                    self._known[key] = tower.textures(shorter_side(image, SIDE))[0], colors(image)[0]
        textures, ramps = (torch.stack([self._known[key][part] for key in keys]) for part in (0, 1))
        textures = textures * (1 + self.feature_noise * torch.randn_like(textures))
        return tower.join(textures, ramps), ramps

    def contrast(
        self, pictures: Float[Tensor, "M D"], captions: Float[Tensor, "M D"], photos: int
    ) -> Float[Tensor, ""]:
        """Symmetric contrastive cross-entropy; each of the last ``photos`` pictures matches all of their captions."""
        logits = pictures @ captions.T / self.log_temperature.exp().clamp(0.02, 1.0)
        together = torch.eye(len(pictures), device=pictures.device)
        if photos:
            together[-photos:, -photos:] = 1 / photos
        return (F.cross_entropy(logits, together) + F.cross_entropy(logits.T, together)) / 2

    def validation_step(self, batch: StyleBatch, step: int) -> None:
        """Log retrieval among the styles of a batch, and how well embeddings predict traits and palettes."""
        pictures = self.style_encoder.embed_images(batch.images)
        captions = self.style_encoder.embed_texts(batch.texts)
        ramps = colors(batch.images)
        figures = retrieval(pictures, captions)
        for name, vectors in (("image", pictures), ("text", captions)):
            named = self.traits.accuracies(self.style_encoder.scaled(vectors), batch.traits)
            figures |= {f"{name}_{trait}": value for trait, value in named.items()}
            figures[f"{name}_palette_error"] = self.palette_error(vectors, ramps)
        self.log_dict({f"val/{name}": value for name, value in figures.items()}, batch_size=len(captions))

    def configure_optimizers(self) -> Any:
        """AdamW with a warm-up and a cosine to 0.2 % of the rate."""
        rate, decay, steps = self.learning_rate, self.weight_decay, self.trainer.max_steps
        return decayed_adamw(self, lr=rate, weight_decay=decay, steps=steps, warmup=self.warmup, floor=2e-3)
