"""Colours as people name them."""

from pathlib import Path

import msgspec


class NamedColor(msgspec.Struct, frozen=True):
    """A colour, 8-bit sRGB, and the words for it, the plainest first."""

    rgb: tuple[int, int, int]
    names: tuple[str, ...]


class _Colors(msgspec.Struct):
    colors: tuple[NamedColor, ...]


COLORS = msgspec.toml.decode(Path(__file__).with_name("words.toml").read_bytes(), type=_Colors).colors
