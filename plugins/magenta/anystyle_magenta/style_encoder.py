"""Pictures and texts as the numbers that steer the style transfer network."""

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleEncoder
from anystyle.types import TextMatch, Tokens
from anystyle.vision.preprocess import middle_square
from anystyle.vision.weights import find, published
from anystyle_magenta.networks import SIDE, STYLE_DIM, StylePrediction, TextTower
from anystyle_magenta.pretrained import GUESSES, SENTENCES, load_prediction, load_text_tower, words_installed
from anystyle_magenta.words import clean

FILE = Path(__file__).parent / "assets" / "descriptions.txt"
"""Texts whose words, all together, are those that the bundled text tower learnt; one per line."""

INSTALL = 'they do next to nothing; pip install "anystyle[words]" brings a sentence network that guesses how they look'
GUESSED = "a sentence network guesses how they look; of artists and their names it knows nothing: give a picture"
"""What is said of words that the text tower never learnt, without and with the extra."""


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
        norm = math.hypot(*map(self._rarity, features))

        def cosine(known: set[str]) -> float:
            shared = sum(self._rarity(feature) ** 2 for feature in features & known)
            return shared / max(norm * math.hypot(*map(self._rarity, known)), 1e-9)

        similarities = list(map(cosine, self._known))
        best = similarities.index(max(similarities))
        unknown = tuple(word for word in dict.fromkeys(clean(text)) if word not in self.words)
        return TextMatch(text, self.texts[best], similarities[best], unknown)

    def unknown_share(self, text: str) -> float:
        """How much of a text is words that occur in none, from 0 to 1; rare words count for more than common ones."""
        words = clean(text)
        unknown = sum(self._rarity(word) for word in words if word not in self.words)
        return unknown / max(sum(map(self._rarity, words)), 1e-9)

    @cached_property
    def _known(self) -> list[set[str]]:
        return list(map(_features, self.texts))

    @cached_property
    def _counts(self) -> Counter[str]:
        return Counter(feature for features in self._known for feature in features)

    def _rarity(self, feature: str) -> float:
        return math.log(len(self.texts) / max(1, self._counts[feature]))


def _features(text: str) -> set[str]:
    words = clean(text)
    return {*words, *(f"#{f'<{word}>'[start : start + 3]}" for word in words for start in range(len(word)))}


class MagentaEncoder(StyleEncoder):
    """Magenta's style prediction network, and a text tower that predicts its vectors from captions.

    Its vectors are not of unit norm, since the style transfer network depends on their lengths; they may be mixed
    linearly. The text tower is not Magenta's. It knows a few hundred words for colours, patterns, media, things and
    manners; :meth:`match_text` says which words of a text it does not know. With the extra ``words`` a sentence network
    guesses what these look like.

    Args:
        pretrained: Whether the networks have their weights (``anystyle weights list magenta_predict magenta_text``).
    """

    unit_norm: bool = False
    token_dim: int | None = 1280

    def __init__(self, *, pretrained: bool = True) -> None:
        super().__init__()
        self.dim = STYLE_DIM
        self.neutral = "a photo"
        self.network = StylePrediction()
        self.text_tower = TextTower()
        self.descriptions = Descriptions()
        if pretrained:
            self.sources = (load_prediction(self.network), load_text_tower(self.text_tower))
        self.guesses = pretrained and words_installed()
        if self.guesses:
            self.sources += tuple(published(name, find(name)) for name in (GUESSES, SENTENCES))

    def embed_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M D"]:
        """Embeddings of the square in the middle of images, resized to 256 x 256 pixels; differentiable."""
        return self.network(centre_square(images))

    def embed_tokens(self, images: Float[Tensor, "M 3 H W"]) -> Tokens:
        """What the network sees at 8 x 8 places of that square, 1280 numbers of at least 0 each."""
        features = self.network.features(centre_square(images))  # M C 8 8
        return Tokens(features.flatten(2).mT[:, None], grid=(features.shape[-2], features.shape[-1]))

    def embed_texts(self, texts: Sequence[str]) -> Float[Tensor, "M D"]:
        vectors = self.text_tower(texts)
        return torch.stack(list(map(self._guess, texts, vectors))) if self.guesses else vectors

    def _guess(self, text: str, vector: Float[Tensor, " D"]) -> Float[Tensor, " D"]:
        """Between the words that the text tower knows and a guess at the whole text; known texts stay as they are."""
        share = self.descriptions.unknown_share(text)
        if share == 0:
            return vector
        from anystyle_magenta.phrases import load_guesses, sentence_network

        known = " ".join(word for word in clean(text) if word in self.descriptions.words)
        guess = load_guesses()(sentence_network()([text]))[0].to(vector)
        return torch.lerp(self.text_tower([known])[0], guess, share) if known else guess

    def match_text(self, text: str) -> TextMatch:
        """The nearest known description; similarity is that of the words' spelling, from 0 to 1."""
        return replace(self.descriptions.match(text), remedy=GUESSED if self.guesses else INSTALL)


def centre_square(images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 256 256"]:
    """The square in the middle, resized to the size that the network was trained with."""
    square = middle_square(images)
    if square.shape[-1] == SIDE:
        return square
    return F.interpolate(square, size=(SIDE, SIDE), mode="bicubic", antialias=True, align_corners=False).clamp(0, 1)
