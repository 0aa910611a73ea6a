"""A small style encoder, trained on procedural styles and their captions."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Bool, Float
from kornia.color import rgb_to_grayscale
from torch import Tensor, nn

from anystyle.contracts import StyleEncoder
from anystyle.vision.statistics import pooled_moments
from anystyle.vision.vgg import Texture
from anystyle_magenta.words import WordTable

TAPS = ("relu1_2", "relu2_2", "relu3_2", "relu4_1")
TAP_CHANNELS = (32, 64, 96, 128)
SIDE = 64
"""Shorter side of the images that textures are read off."""
COLORED_SIDE = 96
"""Shorter side, at most, of those that colours are read off. A smaller copy mixes what lies side by side: the ramp of
one of 64 pixels is 2 % of the variance off."""
COLORS, KNOTS = 32, 12
"""Colours of the ramps that the image tower reads, and that an embedding gives back."""


class Tiny(StyleEncoder):
    """Images and texts in a space of textures and palettes; 1.2 M parameters, no download.

    Images go through the convolutions of the texture network, pooled to mean and deviation at every scale, beside the
    ramp of their colours from dark to light. Texts go through hashed words and a small transformer. Each modality is
    centred, both are whitened by one matrix, so that patterns weigh as much as the colours that dominate raw
    embeddings.

    Args:
        dim: Dimensions of the space.
        text_width: Channels of the text transformer.
        text_layers: Its layers.
        buckets: Rows of the table of hashed words.
        max_words: The longest text it reads.
    """

    image_mean: Tensor
    text_mean: Tensor
    whitening: Tensor

    def __init__(
        self, *, dim: int = 128, text_width: int = 96, text_layers: int = 2, buckets: int = 2048, max_words: int = 64
    ) -> None:
        super().__init__()
        self.dim = dim
        self.neutral = "a photo"
        self.image_tower = ImageTower(dim)
        self.text_tower = TinyTextTower(dim, text_width, text_layers, buckets, max_words)
        self.palette_head = nn.Linear(dim, 3 * KNOTS)
        nn.init.constant_(self.palette_head.bias, 0.5)
        self.register_buffer("image_mean", torch.zeros(dim))
        self.register_buffer("text_mean", torch.zeros(dim))
        self.register_buffer("whitening", torch.eye(dim))

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of sRGB images of any size; textures and colours are read off copies of 64 and 96 pixels."""
        return F.normalize((self.image_tower(images) - self.image_mean) @ self.whitening, dim=-1)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        return F.normalize((self.text_tower(texts) - self.text_mean) @ self.whitening, dim=-1)

    def palette(self, vectors: Float[Tensor, "M D"]) -> Float[Tensor, "M colors 3"]:
        """Twelve sRGB colours from dark to light, each for a twelfth of the pixels, that an embedding stands for.

        They are linear in the embedding, and so may lie a little outside [0, 1].
        """
        # Elements of about unit size, as linear layers expect them.
        return self.palette_head(vectors * self.dim**0.5).unflatten(-1, (KNOTS, 3))


class ImageTower(nn.Module):
    """From images to raw vectors of about unit norm."""

    def __init__(self, dim: int) -> None:
        super().__init__()
        self.texture = Texture()
        pooled = 2 * sum(TAP_CHANNELS)
        self.norm = nn.LayerNorm(pooled)
        self.head = nn.Sequential(nn.Linear(pooled + 3 * COLORS, 512), nn.GELU(), nn.Linear(512, dim))

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        # Mean and deviation of the texture network's features at four scales.
        taps = self.texture(shorter_side(images, SIDE), TAPS)
        textures = torch.cat([pooled_moments(tap.float()) for tap in taps], dim=-1)
        # Colours are spared the norm: how far they are from grey is what they say.
        read = torch.cat([self.norm(textures), (colors(images).flatten(1) - 0.5) * 4], dim=-1)
        return F.normalize(self.head(read), dim=-1)


class TinyTextTower(nn.Module):
    """From texts to raw vectors of unit norm."""

    def __init__(self, dim: int, width: int, layers: int, buckets: int, max_words: int) -> None:
        super().__init__()
        self.max_words = max_words
        self.table = WordTable(buckets, width)
        self.positions = nn.Parameter(0.1 * torch.randn(max_words, width))
        self.blocks = nn.ModuleList(TextBlock(width) for _ in range(layers))
        self.norm = nn.LayerNorm(width)
        self.head = nn.Linear(width, dim)

    def forward(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        tokens, present = self.table.read(texts, self.max_words)
        tokens = tokens + self.positions[: tokens.shape[1]]
        for block in self.blocks:
            tokens = block(tokens, present)
        mean = (tokens * present[..., None]).sum(1) / present.sum(1, keepdim=True)
        return F.normalize(self.head(self.norm(mean)), dim=-1)


class TextBlock(nn.Module):
    """A pre-norm transformer layer."""

    def __init__(self, width: int, heads: int = 4) -> None:
        super().__init__()
        self.heads = heads
        self.norm1, self.norm2 = nn.LayerNorm(width), nn.LayerNorm(width)
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)
        self.mlp = nn.Sequential(nn.Linear(width, 3 * width), nn.GELU(), nn.Linear(3 * width, width))

    def forward(self, tokens: Float[Tensor, "M L C"], present: Bool[Tensor, "M L"]) -> Float[Tensor, "M L C"]:
        parts = self.qkv(self.norm1(tokens)).chunk(3, dim=-1)
        q, k, v = (part.unflatten(-1, (self.heads, -1)).transpose(1, 2) for part in parts)
        mixed = F.scaled_dot_product_attention(q, k, v, attn_mask=present[:, None, None, :])
        tokens = tokens + self.proj(mixed.transpose(1, 2).flatten(2))
        return tokens + self.mlp(self.norm2(tokens))


def colors(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M knots 3"]:
    """The ramps that the image tower reads, of images of any size."""
    return ramp(shorter_side(images, min(COLORED_SIDE, *images.shape[-2:])), COLORS)


def shorter_side(images: Float[Tensor, "M 3 H W"], side: int) -> Float[Tensor, "M 3 h w"]:
    """Images whose shorter side is ``side`` pixels, their aspect kept."""
    height, width = images.shape[-2:]
    scale = side / min(height, width)
    size = max(side, round(height * scale)), max(side, round(width * scale))
    if size == (height, width):
        return images
    return F.interpolate(images, size=size, mode="bilinear", align_corners=False, antialias=True)


def ramp(images: Float[Tensor, "B 3 h w"], knots: int) -> Float[Tensor, "B knots 3"]:
    """The colours of each image from the dark to the light end of their first principal axis."""
    colors = images.flatten(2).mT
    centred = colors - colors.mean(1, keepdim=True)
    axis = torch.linalg.eigh(centred.mT @ centred).eigenvectors[..., -1:]  # B 3 1
    lighter = torch.where(rgb_to_grayscale(axis[..., None])[..., 0] < 0, -1.0, 1.0)
    order = (centred @ (axis * lighter)).argsort(dim=1)
    return F.adaptive_avg_pool1d(colors.gather(1, order.expand_as(colors)).mT, knots).mT
