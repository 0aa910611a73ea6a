"""Texts that the bundled text tower learnt from, and which of them comes nearest to another."""

import math
from collections import Counter
from functools import cached_property
from pathlib import Path

from anystyle.nn.words import clean
from anystyle.types import TextMatch

FILE = Path(__file__).parent / "assets" / "descriptions.txt"
"""Texts whose words, all together, are those that the bundled text tower learnt; one a line."""


class Descriptions:
    """Known texts, compared by their words and the letter triples of these, rare ones first (tf-idf)."""

    @cached_property
    def texts(self) -> list[str]:
        """The lines of :data:`FILE`."""
        return FILE.read_text(encoding="utf-8").splitlines()

    @cached_property
    def words(self) -> frozenset[str]:
        """Every word that occurs."""
        return frozenset(word for text in self.texts for word in clean(text))

    def match(self, text: str) -> TextMatch:
        """The nearest known text, by the cosine of tf-idf vectors, and the words of ``text`` that occur in none."""
        features = _features(text)
        vectors = self._vectors
        rarest = math.log(len(vectors))
        norm = math.sqrt(sum(self._rarity.get(feature, rarest) ** 2 for feature in features))

        def cosine(index: int) -> float:
            vector = vectors[index]
            shared = sum(vector[feature] * self._rarity[feature] for feature in features & vector.keys())
            return shared / max(norm, 1e-9)

        best = max(range(len(vectors)), key=cosine)
        unknown = tuple(word for word in dict.fromkeys(clean(text)) if word not in self.words)
        return TextMatch(text, self.texts[best], cosine(best), unknown)

    @cached_property
    def _rarity(self) -> dict[str, float]:
        counts = Counter(feature for text in self.texts for feature in _features(text))
        return {feature: math.log(len(self.texts) / count) for feature, count in counts.items()}

    @cached_property
    def _vectors(self) -> list[dict[str, float]]:
        vectors: list[dict[str, float]] = []
        for text in self.texts:
            rarity = {feature: self._rarity[feature] for feature in _features(text)}
            norm = math.sqrt(sum(value**2 for value in rarity.values()))
            vectors.append({feature: value / norm for feature, value in rarity.items()})
        return vectors


def _features(text: str) -> set[str]:
    words = clean(text)
    return {*words, *(f"#{framed[start : start + 3]}" for word in words for framed in [f"<{word}>"]
                      for start in range(len(framed) - 2))}  # fmt: skip
