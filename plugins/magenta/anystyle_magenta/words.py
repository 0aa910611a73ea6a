"""Embeddings of hashed words: no vocabulary, and no unknown words."""

import re
import unicodedata
import zlib
from collections.abc import Sequence

import torch
from jaxtyping import Bool, Float
from torch import Tensor, nn

from anystyle.errors import UserError

WORD = re.compile(r"[^\W_]+")


class WordTable(nn.EmbeddingBag):
    """Vectors of words: the mean of the rows that a word and its letter triples are hashed to."""

    def __init__(self, buckets: int, width: int) -> None:
        super().__init__(buckets, width, mode="mean")

    def read(self, texts: Sequence[str], max_words: int) -> tuple[Float[Tensor, "M L C"], Bool[Tensor, "M L"]]:
        """Vectors of the words of each text, padded with 0, and the mask of those that are words."""
        device = self.weight.device
        hashed = [hash_words(text, buckets=self.num_embeddings, max_words=max_words) for text in texts]
        lengths = torch.tensor([len(words) for words in hashed], device=device)
        present = torch.arange(int(lengths.max()), device=device) < lengths[:, None]
        bags = [word for words in hashed for word in words]
        rows = torch.tensor([row for bag in bags for row in bag], device=device)
        starts = torch.tensor([0, *(len(bag) for bag in bags[:-1])], device=device).cumsum(0)
        vectors = self.weight.new_zeros(*present.shape, self.embedding_dim)
        vectors[present] = self(rows, starts)
        return vectors, present


def clean(text: str) -> list[str]:
    """The words of a text in lower case, without accents, punctuation and quotes."""
    plain = unicodedata.normalize("NFKD", text.casefold())
    return WORD.findall("".join(letter for letter in plain if not unicodedata.combining(letter)))


def hash_words(text: str, *, buckets: int, max_words: int) -> list[tuple[int, ...]]:
    """For each word the row, of ``buckets``, of the word itself, then those of its letter triples.

    Triples make words that share a stem alike, and give a word never seen in training the meaning of its parts.
    """
    words = clean(text)
    if not words:
        raise UserError(f"the style text {text[:40]!r} holds no word; describe colours and patterns")
    if len(words) > max_words:
        raise UserError(
            f"the style text {text[:40]!r}… has {len(words)} words, and this encoder reads {max_words}; shorten it"
        )

    def row(key: str) -> int:
        return zlib.crc32(key.encode()) % buckets

    framed = [f"<{word}>" for word in words]
    return [
        (row(word), *(row(f"#{frame[start : start + 3]}") for start in range(len(frame) - 2)))
        for word, frame in zip(words, framed, strict=True)
    ]
