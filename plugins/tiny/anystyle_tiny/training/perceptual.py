"""Training the texture network: a small VGG that names patterns, whatever their colours."""

import copy
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

from anystyle.ranges import AtLeastOne, Count, Positive
from anystyle.training.optim import decayed_adamw
from anystyle.vision.features import walk
from anystyle.vision.statistics import pooled_moments
from anystyle.vision.vgg import Texture
from anystyle_tiny.training.styles import TRAITS, UNKNOWN, StyleBatch, StyleTraining, TraitHeads

TAPS = ("relu2_2", "relu3_2", "relu4_1")
POOLED = 2 * (64 + 96 + 128)
COLORS = 4
"""Colours of a palette."""


class PerceptualTraining(StyleTraining):
    """Teach a small convolutional network to tell procedural patterns, their scales and their brushwork apart.

    Augmentations make it a judge of texture: in half of the pictures colour channels are permuted and inverted, some
    are blended with a photograph, and all are turned, cropped and re-lit. It also predicts the palette of the result.

    Args:
        batch_size: Pictures per step.
        photos: Photographs per step, for blending.
        crop: Side of the squares that the network sees, in pixels.
        shrink: Fraction of pictures that are resized to the square instead of cropped; their scale is not supervised.
        pool: Styles to draw from, kept in memory; none means all there are.
        recolor: Fraction of pictures whose channels are permuted and inverted.
        blend: Fraction of pictures that are blended with a photograph.
        scale_weight: Weight of naming the scale and the brushwork, relative to the pattern.
        palette_weight: Weight of the palette.
        learning_rate: Peak learning rate of AdamW.
        warmup: Steps of the warm-up.
        weight_decay: Weight decay of filters and matrices.
        bf16: Whether convolutions compute in bfloat16, which halves the time on processors that support it.
    """

    def __init__(
        self,
        *,
        batch_size: AtLeastOne = 48,
        photos: Count = 8,
        crop: int = 64,
        shrink: float = 0.4,
        pool: AtLeastOne | None = 8000,
        recolor: float = 0.5,
        blend: float = 0.3,
        scale_weight: float = 0.5,
        palette_weight: float = 5.0,
        learning_rate: Positive = 3e-3,
        warmup: Count = 30,
        weight_decay: float = 0.01,
        bf16: bool = True,
    ) -> None:
        super().__init__()
        self.batch_size, self.photos, self.crop, self.pool = batch_size, photos, crop, pool
        self.recolor, self.blend, self.shrink, self.bf16 = recolor, blend, shrink, bf16
        self.scale_weight, self.palette_weight = scale_weight, palette_weight
        self.learning_rate, self.warmup, self.weight_decay = learning_rate, warmup, weight_decay
        self.network = NormedTexture()
        self.norm = nn.BatchNorm1d(POOLED)
        self.traits = TraitHeads(POOLED)
        self.palette = nn.Linear(POOLED, 3 * COLORS)

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"batch_size": 4, "photos": 2, "pool": 8, "crop": 24, "warmup": 1, "bf16": False}

    def exports(self) -> Mapping[str, nn.Module]:
        """The network, without its normalisations."""
        return {"texture": self.network.folded()}

    def training_step(self, batch: StyleBatch, step: int) -> Tensor:
        shrunk = torch.rand(len(batch.images), device=batch.images.device) < self.shrink
        images = self.varied(batch, shrunk)
        pooled = self.pooled(images)
        traits = batch.traits.clone()
        traits[shrunk, list(TRAITS).index("scale")] = UNKNOWN
        named = self.traits.losses(pooled, traits, smoothing=0.05)
        palette = palette_loss(self.colors(pooled), images).mean()
        total = named["pattern"] + self.scale_weight * (named["scale"] + named["brushwork"])
        total = total + self.palette_weight * palette
        self.log("train/loss", total, batch_size=len(images), prog_bar=True)
        self.log_dict({f"train/{name}": value for name, value in named.items()}, batch_size=len(images))
        self.log("train/palette", palette, batch_size=len(images))
        return total

    def validation_step(self, batch: StyleBatch, step: int) -> None:
        """Log the fractions of traits that are named right, of squares cut from the middle of pictures as they are."""
        top, left = ((side - self.crop) // 2 for side in batch.images.shape[-2:])
        images = batch.images[..., top : top + self.crop, left : left + self.crop]
        pooled = self.pooled(images)
        figures = self.traits.accuracies(pooled, batch.traits)
        figures["palette_rms"] = palette_loss(self.colors(pooled), images).sqrt().mean()
        self.log_dict({f"val/{name}": value for name, value in figures.items()}, batch_size=len(images))

    def pooled(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M C"]:
        """Mean and deviation of the features of three scales."""
        with torch.autocast(images.device.type, torch.bfloat16, enabled=self.bf16):
            taps = self.network(images.contiguous(memory_format=torch.channels_last), TAPS)
        return self.norm(torch.cat([pooled_moments(tap.float()) for tap in taps], dim=-1))

    def colors(self, pooled: Float[Tensor, "M C"]) -> Float[Tensor, "M colors 3"]:
        """Palettes in sRGB."""
        return self.palette(pooled).sigmoid().unflatten(-1, (COLORS, 3))

    def varied(self, batch: StyleBatch, shrunk: Bool[Tensor, " M"]) -> Float[Tensor, "M 3 c c"]:
        """The styles of a batch turned, cropped or made smaller, recoloured, some with a photograph through them."""
        images, count = _cropped(batch.images, self.crop), len(batch.images)
        whole = F.interpolate(batch.images, size=(self.crop, self.crop), mode="bilinear", antialias=True)
        images = torch.where(shrunk[:, None, None, None], whole, images)
        if len(batch.photos):
            photos = _cropped(batch.photos, self.crop)[torch.randint(len(batch.photos), (count,))]
            amount = 0.5 * torch.rand(count, 1, 1, 1) * (torch.rand(count, 1, 1, 1) < self.blend)
            images = torch.lerp(images, photos, amount.to(images).expand_as(images))
        chosen = torch.rand(count, 1, 1, 1) < self.recolor
        images = torch.where(chosen.to(images.device), _recolored(images), images)
        gain, shift = 0.7 + 0.3 * torch.rand(count, 1, 1, 1), torch.rand(count, 1, 1, 1)
        return images * gain.to(images) + (shift * (1 - gain)).to(images)

    def configure_optimizers(self) -> Any:
        """AdamW with a warm-up and a cosine to 1 % of the rate."""
        rate, decay, steps = self.learning_rate, self.weight_decay, self.trainer.max_steps
        return decayed_adamw(self, lr=rate, weight_decay=decay, steps=steps, warmup=self.warmup, betas=(0.9, 0.999))


class NormedTexture(nn.Module):
    """The texture network with a batch normalisation after each convolution, which learning needs and use does not."""

    def __init__(self) -> None:
        super().__init__()
        plain = Texture()
        self.names = plain.names
        self.features = nn.Sequential(
            *(nn.Sequential(stage, nn.BatchNorm2d(stage.out_channels)) if isinstance(stage, nn.Conv2d) else stage
              for stage in plain.features)
        )  # fmt: skip

    def forward(self, images: Float[Tensor, "M 3 H W"], layers: Sequence[str]) -> list[Float[Tensor, "M _ _ _"]]:
        """The features of the layers that are asked for."""
        return walk(self.features, self.names, images, (images - 0.5) * 4, layers)

    def folded(self) -> Texture:
        """The same network with its normalisations folded into its convolutions."""
        plain, trained = Texture(), copy.deepcopy(self).eval()
        for target, stage in zip(plain.features, trained.features, strict=True):
            if isinstance(stage, nn.Sequential):
                target.load_state_dict(fuse_conv_bn_eval(*stage).state_dict())  # pyright: ignore[reportArgumentType]
        return plain


def _cropped(images: Float[Tensor, "M 3 H W"], side: int) -> Float[Tensor, "M 3 side side"]:
    """One random square of each, mirrored and turned by quarters."""
    cut = []
    for image in images:
        top, left = (int(torch.randint(whole - side + 1, ())) for whole in image.shape[1:])
        piece = image[:, top : top + side, left : left + side]
        flips = [axis for axis in (-2, -1) if torch.rand(()) < 0.5]
        piece = piece.flip(flips)
        cut.append(piece.mT if torch.rand(()) < 0.5 else piece)
    return torch.stack(cut) if cut else images[..., :side, :side]


def _recolored(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
    """Channels permuted, and half of them inverted, independently for each picture."""
    order = torch.rand(len(images), 3).argsort(dim=1).to(images.device)
    permuted = images.gather(1, order[:, :, None, None].expand_as(images))
    inverted = (torch.rand(len(images), 3, 1, 1) < 0.5).to(images.device)
    return torch.where(inverted, 1 - permuted, permuted)


def palette_loss(
    palette: Float[Tensor, "M colors 3"], images: Float[Tensor, "M 3 H W"], *, directions: int = 16
) -> Float[Tensor, " M"]:
    """How far the pixels are from a palette of colours of equal weight: a sliced Wasserstein distance, squared.

    Along a direction the sorted pixels are split into as many equal groups as there are colours, and each group is
    carried to the colour of its rank; the part that no palette could avoid, the spread within groups, is left out.
    """
    count = palette.shape[1]
    axes = F.normalize(torch.randn(directions, 3, device=images.device, dtype=palette.dtype), dim=-1)
    # Three pixels in four are left out: colours of a picture repeat.
    pixels = images[..., ::2, ::2].flatten(2).to(palette.dtype)
    pixels = pixels[..., : pixels.shape[-1] // count * count]
    sorted_pixels = (axes @ pixels).sort(dim=-1).values  # M directions S
    groups = sorted_pixels.unflatten(-1, (count, -1)).mean(-1)
    ranked = (axes @ palette.mT).sort(dim=-1).values
    return (ranked - groups).square().mean((-2, -1))
