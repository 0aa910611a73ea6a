"""A second small style encoder, of another make, by which stylizations are judged and no model is trained."""

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.contracts import StyleEncoder
from anystyle.nn.words import WordTable
from anystyle.perception.statistics import pooled_moments


class HeldoutEncoder(StyleEncoder):
    """Images and texts in a space of its own; 0.3 M parameters, trained from scratch on styles held out from training.

    Images go through strided convolutions, pooled to mean and deviation at every scale, beside a learnt soft histogram
    of colours. Texts go through hashed words and one convolution over neighbouring words. Nothing is shared with the
    encoder that guides a model: neither weights nor layers nor the styles they learnt from.

    Args:
        dim: Of the space.
        widths: Channels of the convolutions, each at half the resolution of the one before.
        colors: Channels of the histogram.
        text_width: Channels of a word.
        buckets: Rows of the table of hashed words.
        max_words: The longest text it reads.
        side: Pixels of the square that images are squashed to.
    """

    def __init__(
        self,
        *,
        dim: int = 64,
        widths: Sequence[int] = (24, 48, 72, 96),
        colors: int = 48,
        text_width: int = 64,
        buckets: int = 1024,
        max_words: int = 64,
        side: int = 64,
    ) -> None:
        super().__init__()
        self.dim = dim
        self.neutral = "a photo"
        self.side, self.max_words = side, max_words
        self.stages = nn.ModuleList(
            _Stage(before, after) for before, after in zip((3, *widths[:-1]), widths, strict=True)
        )
        self.colors = nn.Sequential(nn.Conv2d(3, 32, 1), nn.SiLU(), nn.Conv2d(32, colors, 1), nn.SiLU())
        self.image_head = _head(2 * sum(widths) + colors, dim)
        self.table = WordTable(buckets, text_width)
        self.neighbours = nn.Conv1d(text_width, text_width, 3, padding=1)
        self.text_head = _head(2 * text_width, dim)

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """See :meth:`StyleEncoder.embed_images`."""
        side = (self.side, self.side)
        squares = F.interpolate(images, size=side, mode="bilinear", align_corners=False, antialias=True)
        current = small = (squares - 0.5) * 4
        pooled = [self.colors(small[..., ::2, ::2]).mean((-2, -1))]
        for stage in self.stages:
            current = stage(current)
            pooled.append(pooled_moments(current))
        return F.normalize(self.image_head(torch.cat(pooled, dim=-1)), dim=-1)

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        """See :meth:`StyleEncoder.embed_texts`."""
        words, present = self.table.read(texts, self.max_words)
        mixed = (words + F.silu(self.neighbours(words.mT)).mT) * present[..., None]
        mean = mixed.sum(1) / present.sum(1, keepdim=True)
        most = mixed.masked_fill(~present[..., None], -torch.inf).amax(1)
        return F.normalize(self.text_head(torch.cat([mean, most], dim=-1)), dim=-1)


class _Stage(nn.Sequential):
    def __init__(self, before: int, after: int) -> None:
        super().__init__(nn.Conv2d(before, after, 3, stride=2, padding=1), nn.GroupNorm(4, after), nn.SiLU())


def _head(channels: int, dim: int) -> nn.Sequential:
    return nn.Sequential(nn.LayerNorm(channels), nn.Linear(channels, 160), nn.SiLU(), nn.Linear(160, dim))
