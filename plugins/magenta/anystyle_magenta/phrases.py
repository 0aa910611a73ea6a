"""Embeds out-of-vocabulary words by the looks of words that a sentence network says they are close to."""

import gzip
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError
from anystyle.vision import weights
from anystyle_magenta.pretrained import GUESSES, SENTENCES
from anystyle_magenta.words import clean

ASSETS = Path(__file__).parent / "assets"
SHARPNESS, NEARNESS = 6.0, 20.0
"""Scales of the kernel and of the neighbours, for which the regression was fitted; they matter little."""
MOST = 510
"""Word pieces of a text that count, for the network has places for 512."""


class SentenceNetwork:
    """all-MiniLM-L6-v2, a transformer of 6 layers (Wang et al. 2020), run by onnxruntime on the CPU."""

    def __init__(self) -> None:
        import onnxruntime  # pyright: ignore[reportMissingImports]

        file = weights.find(SENTENCES)
        if not weights.verified(SENTENCES, file):
            raise UserError(f"{file} is not the published file; get it from {weights.row(SENTENCES).source}")
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = torch.get_num_threads()
        self.session = onnxruntime.InferenceSession(str(file), options, providers=["CPUExecutionProvider"])
        pieces = gzip.decompress((ASSETS / "wordpieces.txt.gz").read_bytes()).decode().split("\n")
        self.rows = {piece: row for row, piece in enumerate(pieces)}

    def __call__(self, texts: Sequence[str]) -> Float[Tensor, "M 384"]:
        """Unit vectors of texts: the mean over their word pieces."""
        vectors = []
        for text in texts:
            pieces = [piece for word in clean(text) for piece in self._pieces(word)][:MOST]
            rows = np.array([[self.rows[piece] for piece in ("[CLS]", *pieces, "[SEP]")]])
            inputs = {"input_ids": rows, "attention_mask": np.ones_like(rows), "token_type_ids": np.zeros_like(rows)}
            (states,) = self.session.run(None, inputs)
            vectors.append(torch.from_numpy(states).mean(1))
        return F.normalize(torch.cat(vectors), dim=-1)

    def _pieces(self, word: str) -> list[str]:
        """The longest known pieces of a word, from its beginning on."""
        pieces: list[str] = []
        while word:
            prefix = "##" if pieces else ""
            size = next((size for size in range(len(word), 0, -1) if prefix + word[:size] in self.rows), 0)
            if size == 0:
                return ["[UNK]"]
            pieces.append(prefix + word[:size])
            word = word[size:]
        return pieces


@cache
def sentence_network() -> SentenceNetwork:
    """The network, read once per process."""
    return SentenceNetwork()


@dataclass(frozen=True)
class Guesses:
    """From sentence vectors to style vectors: half way between kernel ridge regression and the nearest known texts.

    Regression finds concepts better, neighbours synonyms. Both draw what they hardly know towards the mean, and such a
    style is grey; so every guess is as far from the mean as known texts are on average.
    """

    known: Float[Tensor, "N 384"]
    styles: Float[Tensor, "N 100"]  # about their own mean
    coefficients: Float[Tensor, "N 100"]
    average: Float[Tensor, "100"]  # of the regression over the known texts
    mean: Float[Tensor, "100"]
    distance: Float[Tensor, ""]

    def __call__(self, sentences: Float[Tensor, "M 384"]) -> Float[Tensor, "M 100"]:
        """Style vectors of sentences."""
        kernel = torch.exp(SHARPNESS * (sentences @ self.known.T - 1))
        regressed = kernel @ self.coefficients - self.average
        nearest = torch.softmax(NEARNESS * sentences @ self.known.T, dim=-1) @ self.styles
        directions = F.normalize(regressed, dim=-1) + F.normalize(nearest, dim=-1)
        return self.mean + self.distance * F.normalize(directions, dim=-1)


@cache
def load_guesses() -> Guesses:
    """The bundled regression, read once per process."""
    return Guesses(**{name: tensor.float() for name, tensor in weights.read(weights.find(GUESSES)).items()})
