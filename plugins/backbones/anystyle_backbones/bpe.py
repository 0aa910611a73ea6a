"""CLIP's tokeniser: lower-case byte-pair encoding."""

import gzip
import html
import unicodedata
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

from anystyle.errors import UserError
from anystyle.io.documents import parsing

SUFFIXES = ("'s", "'t", "'re", "'ve", "'m", "'ll", "'d")
END = "</w>"
_STRAIGHT = str.maketrans("‘’‚“”„", "'''\"\"\"")


class Tokenizer:
    """Maps texts to ids of tokens, by pairs of symbols in the order in which they are merged."""

    def __init__(self, merges: Sequence[tuple[str, str]]) -> None:
        letters = list(_letters().values())
        symbols = [*letters, *(letter + END for letter in letters), *map("".join, merges)]
        self.ids = {symbol: index for index, symbol in enumerate(symbols)}
        self.start, self.end = len(symbols), len(symbols) + 1
        self._ranks = {pair: rank for rank, pair in enumerate(merges)}
        self._known: dict[str, list[int]] = {}

    def encode(self, text: str) -> list[int]:
        """The ids of a text, between those of its start and its end."""
        return [self.start, *(token for word in words(clean(text)) for token in self._word(word)), self.end]

    def _word(self, word: str) -> list[int]:
        if word in self._known:
            return self._known[word]
        symbols = [_letters()[byte] for byte in word.encode()]
        symbols[-1] += END
        while known := [pair for pair in pairwise(symbols) if pair in self._ranks]:
            first, joined = min(known, key=self._ranks.__getitem__), list[str]()
            for symbol in symbols:
                if joined and (joined[-1], symbol) == first:
                    joined[-1] += symbol
                else:
                    joined.append(symbol)
            symbols = joined
        return self._known.setdefault(word, [self.ids[symbol] for symbol in symbols])


@cache
def load(path: Path, size: int) -> Tokenizer:
    """The tokeniser with the first ``size`` tokens of CLIP's ``bpe_simple_vocab_16e6.txt.gz`` or a ``merges.txt``.

    The file has a comment, then one pair of symbols a line.
    """
    num_merges = size - 2 * 256 - 2
    with parsing(path, "vocabulary of CLIP; get it again"):
        content = path.read_bytes()
        text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode("utf-8")
    merges = [tuple(line.split()) for line in text.split("\n")[1 : num_merges + 1]]
    if len(merges) < num_merges or any(len(pair) != 2 for pair in merges):
        raise UserError(f"{path} holds no {num_merges} pairs of symbols; get CLIP's vocabulary again")
    return Tokenizer([(first, second) for first, second in merges])


def clean(text: str) -> str:
    """Lower case, single spaces, straight quotes, HTML entities resolved: CLIP was trained on web pages."""
    text = unicodedata.normalize("NFC", html.unescape(html.unescape(text)).translate(_STRAIGHT))
    return " ".join(text.split()).lower()


def words(text: str) -> Iterator[str]:
    """Runs of letters, single digits, runs of other signs, and English endings such as ``'s``."""
    start = 0
    while start < len(text):
        kind = _kind(text[start])
        suffix = next((suffix for suffix in SUFFIXES if text.startswith(suffix, start)), "")
        end = start + max(1, len(suffix))
        while not suffix and kind != "number" and end < len(text) and _kind(text[end]) == kind:
            end += 1
        if kind != "space":
            yield text[start:end]
        start = end


def _kind(letter: str) -> str:
    kinds = {"L": "letter", "N": "number"}
    return "space" if letter.isspace() else kinds.get(unicodedata.category(letter)[0], "sign")


@cache
def _letters() -> dict[int, str]:
    """A visible letter for each byte, in the vocabulary's order: printable ones themselves, then those from 256 on."""
    printable = [*range(33, 127), *range(161, 173), *range(174, 256)]
    hidden = sorted({*range(256)}.difference(printable))
    return {byte: chr(byte) for byte in printable} | {byte: chr(256 + index) for index, byte in enumerate(hidden)}
