"""Captions of procedural paintings in natural words."""

from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec

from anystyle_tiny.procedural.layout import Draw

SCALES = ("fine", "medium", "coarse")
DIRECTIONS = ("horizontal", "vertical", "diagonal")


class NamedColor(msgspec.Struct, frozen=True):
    """A colour, 8-bit sRGB, and the words for it, the plainest first."""

    rgb: tuple[int, int, int]
    names: tuple[str, ...]


class Words(msgspec.Struct, frozen=True):
    """Words for a pattern; ``things`` are shapes on a ground of the palette's first colour."""

    nouns: tuple[str, ...]
    fine: tuple[str, ...] = ("small", "fine", "tiny")
    coarse: tuple[str, ...] = ("large", "big", "bold")
    things: bool = False
    directed: bool = False


class _Vocabulary(msgspec.Struct):
    colors: tuple[NamedColor, ...]
    patterns: dict[str, Words]
    media: dict[str, tuple[str, ...]]


_VOCABULARY = msgspec.toml.decode(Path(__file__).with_name("words.toml").read_bytes(), type=_Vocabulary)
COLORS, WORDS, MEDIA = _VOCABULARY.colors, _VOCABULARY.patterns, _VOCABULARY.media


def join_names(names: Sequence[str], below: Callable[[int], int]) -> str:
    """Names joined as in a sentence."""
    if len(names) == 1:
        return names[0]
    if len(names) == 2:
        return (" and ", " and ", " and ", " with ")[below(4)].join(names)
    return ", ".join(names[:-1]) + (" and ", ", and ")[below(2)] + names[-1]


def describe(draw: Draw, pattern: str, colors: Sequence[int], scale: int, brushwork: str, direction: str | None) -> str:
    """One of many natural phrasings of colours (the ground first), a pattern, a scale and a medium, by index or key."""
    words, below = WORDS[pattern], draw.below
    names = [COLORS[color].names[below(1 + below(len(COLORS[color].names)))] for color in colors]
    noun = words.nouns[below(len(words.nouns))]
    sizes = (words.fine, (), words.coarse)[scale]
    lead = [sizes[below(len(sizes))]] if sizes and below(5) else []
    lead += [direction] if direction is not None and words.directed else []
    medium = MEDIA[brushwork][below(len(MEDIA[brushwork]))] if below(5) < (1 if brushwork == "print" else 3) else ""
    if words.things and len(names) > 1 and below(2):
        ground, shapes = names[0], join_names(names[1:], below)
        setting = (f"on {ground}", f"on a {ground} background", f"over {ground}", f"on a {ground} ground")[below(4)]
        text = " ".join([*lead, shapes, noun, setting])
        return _finish(text, medium, below)
    # Without a ground the colours have no order.
    palette = join_names(draw.shuffled(names), below)
    shape = " ".join([*lead, noun])
    form, plain = below(6), " ".join([*lead, palette, noun])
    text = (plain, plain, f"{shape} in {palette}", f"{palette}, {shape}", plain, f"{shape}, {palette}")[form]
    if form == 4:
        text = ("a pattern of ", "a picture of ", "a painting of ", "a design of ")[below(4)] + plain
    return _finish(text, medium, below)


def _finish(text: str, medium: str, below: Callable[[int], int]) -> str:
    if not medium:
        return text
    joint = ", " if "," in text or below(2) else " "
    return f"{text}{joint}{medium}"
