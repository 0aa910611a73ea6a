"""CLIP's tokeniser: lower-case byte-pair encoding."""

import gzip
import html
import unicodedata
from collections.abc import Iterator, Sequence
from functools import cache
from itertools import pairwise
from pathlib import Path

SUFFIXES = ("'s", "'t", "'re", "'ve", "'m", "'ll", "'d")
END = "</w>"
_STRAIGHT = str.maketrans({"‘": "'", "’": "'", "‚": "'", "“": '"', "”": '"', "„": '"'})


class Tokenizer:
    """Maps texts to ids of tokens.

    Args:
        merges: Pairs of symbols in the order in which they are merged.
    """

    def __init__(self, merges: Sequence[tuple[str, str]]) -> None:
        letters = [letter for _, letter in sorted(_letters().items(), key=lambda pair: _order(pair[0]))]
        symbols = [*letters, *(letter + END for letter in letters), *map("".join, merges)]
        self.ids = {symbol: index for index, symbol in enumerate(symbols)}
        self.start, self.end = len(symbols), len(symbols) + 1
        self._ranks = {pair: rank for rank, pair in enumerate(merges)}
        self._known: dict[str, tuple[int, ...]] = {}

    def encode(self, text: str) -> list[int]:
        """The ids of a text, between those of its start and its end."""
        ids = [self.start]
        for word in words(clean(text)):
            ids.extend(self._word(word))
        return [*ids, self.end]

    def _word(self, word: str) -> tuple[int, ...]:
        if word not in self._known:
            letters = [_letters()[byte] for byte in word.encode()]
            self._known[word] = tuple(self.ids[symbol] for symbol in self._merged([*letters[:-1], letters[-1] + END]))
        return self._known[word]

    def _merged(self, symbols: list[str]) -> list[str]:
        while len(symbols) > 1:
            first = min(pairwise(symbols), key=lambda pair: self._ranks.get(pair, len(self.ids)))
            if first not in self._ranks:
                break
            joined: list[str] = []
            for symbol in symbols:
                if joined and (joined[-1], symbol) == first:
                    joined[-1] += symbol
                else:
                    joined.append(symbol)
            symbols = joined
        return symbols


@cache
def load(path: Path, size: int) -> Tokenizer:
    """The tokeniser of a file of merges.

    Args:
        path: CLIP's ``bpe_simple_vocab_16e6.txt.gz``, or a ``merges.txt``: a comment, then one pair a line.
        size: Of the vocabulary; further lines are not read.

    Raises:
        ValueError: The file holds fewer merges, or is no such file.
    """
    num_merges = size - 2 * 256 - 2
    try:
        content = path.read_bytes()
        text = (gzip.decompress(content) if path.suffix == ".gz" else content).decode("utf-8")
    except (OSError, EOFError, UnicodeDecodeError) as error:
        raise ValueError(f"{path} is no vocabulary of CLIP ({error}); get it again") from None
    merges = [tuple(line.split()) for line in text.split("\n")[1 : num_merges + 1]]
    if len(merges) < num_merges or any(len(pair) != 2 for pair in merges):
        raise ValueError(f"{path} holds no {num_merges} pairs of symbols; get CLIP's vocabulary again")
    return Tokenizer([(first, second) for first, second in merges])


def clean(text: str) -> str:
    """Lower case, single spaces, straight quotes; HTML entities are resolved, for CLIP was trained on web pages."""
    text = unicodedata.normalize("NFC", html.unescape(html.unescape(text)).translate(_STRAIGHT))
    return " ".join(text.split()).lower()


def words(text: str) -> Iterator[str]:
    """Runs of letters, single digits, runs of other signs, and English endings such as ``'s``."""
    start = 0
    while start < len(text):
        kind = _kind(text[start])
        suffix = next((suffix for suffix in SUFFIXES if text.startswith(suffix, start)), None)
        end = start + 1
        if suffix is not None:
            end = start + len(suffix)
        elif kind != "number":
            while end < len(text) and _kind(text[end]) == kind:
                end += 1
        if kind != "space":
            yield text[start:end]
        start = end


def _kind(letter: str) -> str:
    if letter.isspace():
        return "space"
    return {"L": "letter", "N": "number"}.get(unicodedata.category(letter)[0], "sign")


def _printable(byte: int) -> bool:
    return 33 <= byte <= 126 or 161 <= byte <= 172 or byte >= 174


def _order(byte: int) -> int:
    """Sorts bytes as the vocabulary does: printable ones first."""
    return byte if _printable(byte) else 256 + byte


@cache
def _letters() -> dict[int, str]:
    """A visible letter for each byte: itself if it is printable, else one from 256 on."""
    hidden = [byte for byte in range(256) if not _printable(byte)]
    return {byte: chr(byte) for byte in range(256) if _printable(byte)} | {
        byte: chr(256 + index) for index, byte in enumerate(hidden)
    }
