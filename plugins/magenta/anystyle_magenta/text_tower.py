"""Texts as the numbers that steer the style transfer network."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle.nn.words import WordTable
from anystyle_magenta.prediction import STYLE_DIM


class TextTower(nn.Module):
    """From the words of a text to a style vector.

    Hashed words and their letter triples are pooled to the mean and the maximum of their vectors, and a small network
    turns these into coordinates on the principal axes of style vectors.
    """

    mean: Tensor
    axes: Tensor

    def __init__(self, *, width: int = 128, hidden: int = 512, buckets: int = 4096, max_words: int = 64) -> None:
        super().__init__()
        self.max_words = max_words
        self.table = WordTable(buckets, width)
        self.head = nn.Sequential(nn.Linear(2 * width, hidden), nn.GELU(), nn.Linear(hidden, STYLE_DIM))
        self.register_buffer("mean", torch.zeros(STYLE_DIM))
        self.register_buffer("axes", torch.eye(STYLE_DIM))

    def forward(self, texts: Sequence[str]) -> Float[Tensor, "M 100"]:
        """Style vectors of texts."""
        words, present = self.table.read(texts, self.max_words)
        count = present.sum(1, keepdim=True)
        mean = (words * present[..., None]).sum(1) / count.sqrt()
        highest = words.masked_fill(~present[..., None], -torch.inf).amax(1)
        return self.mean + self.head(torch.cat([mean, highest], dim=-1)) @ self.axes

    @torch.no_grad()
    def fit_axes(self, vectors: Float[Tensor, "N 100"]) -> None:
        """Set mean and principal axes, each as long as the standard deviation along it, from example style vectors."""
        self.mean.copy_(vectors.mean(0))
        variances, axes = torch.linalg.eigh(torch.cov(vectors.double().T))
        self.axes.copy_((axes * variances.clamp_min(0).sqrt()).T)
