"""Texts as hashed words: no vocabulary to download, and no word it cannot read."""

import re
import unicodedata
import zlib
from collections.abc import Sequence
from dataclasses import dataclass

WORD = re.compile(r"[^\W_]+")


@dataclass(frozen=True)
class HashedWords:
    """The words of a text, each as a few places in a table.

    Args:
        words: For each word the place of the word itself, then those of its letter triples.
    """

    words: tuple[tuple[int, ...], ...]


def clean(text: str) -> list[str]:
    """The words of a text in lower case, without accents, punctuation and quotes."""
    plain = unicodedata.normalize("NFKD", text.casefold())
    return WORD.findall("".join(letter for letter in plain if not unicodedata.combining(letter)))


def hash_words(text: str, *, buckets: int, max_words: int) -> HashedWords:
    """Hash a text.

    A word's letter triples make words that share a stem alike, and give a word never seen in training the meaning of
    its parts.

    Args:
        text: Any.
        buckets: Rows of the table.
        max_words: The most that the encoder reads.

    Raises:
        ValueError: There is no word, or there are too many.
    """
    words = clean(text)
    if not words:
        raise ValueError(f"the style text {text[:40]!r} holds no word; describe colours and patterns")
    if len(words) > max_words:
        raise ValueError(
            f"the style text {text[:40]!r}… has {len(words)} words, and this encoder reads {max_words}; shorten it"
        )
    return HashedWords(tuple((_place(word, buckets), *_triples(word, buckets)) for word in words))


def _triples(word: str, buckets: int) -> Sequence[int]:
    framed = f"<{word}>"
    return [_place("#" + framed[start : start + 3], buckets) for start in range(len(framed) - 2)]


def _place(key: str, buckets: int) -> int:
    return zlib.crc32(key.encode()) % buckets
