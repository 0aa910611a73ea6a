"""Colours as people name them."""

from typing import NamedTuple


class NamedColor(NamedTuple):
    """A colour and the words for it, the plainest first."""

    rgb: tuple[int, int, int]
    names: tuple[str, ...]


COLORS: tuple[NamedColor, ...] = (
    NamedColor((214, 38, 34), ("red", "bright red", "scarlet", "vermilion")),
    NamedColor((118, 16, 36), ("dark red", "crimson", "burgundy", "maroon")),
    NamedColor((240, 126, 28), ("orange", "bright orange", "tangerine")),
    NamedColor((248, 190, 152), ("peach", "apricot", "light orange")),
    NamedColor((204, 154, 40), ("gold", "golden", "ochre", "mustard")),
    NamedColor((248, 222, 52), ("yellow", "bright yellow", "lemon yellow")),
    NamedColor((250, 242, 214), ("cream", "ivory", "pale yellow", "off-white")),
    NamedColor((122, 124, 42), ("olive", "olive green", "moss green")),
    NamedColor((44, 154, 58), ("green", "bright green", "grass green")),
    NamedColor((168, 218, 66), ("lime", "lime green", "yellow green")),
    NamedColor((16, 78, 46), ("dark green", "forest green", "deep green", "bottle green")),
    NamedColor((166, 226, 190), ("mint", "mint green", "pale green", "light green")),
    NamedColor((14, 118, 122), ("teal", "dark turquoise", "petrol")),
    NamedColor((62, 204, 206), ("turquoise", "aqua", "cyan")),
    NamedColor((150, 202, 240), ("light blue", "sky blue", "pale blue", "baby blue")),
    NamedColor((36, 92, 206), ("blue", "bright blue", "cobalt blue", "royal blue")),
    NamedColor((20, 32, 88), ("navy", "navy blue", "dark blue", "deep blue", "midnight blue")),
    NamedColor((108, 46, 158), ("purple", "violet", "deep purple")),
    NamedColor((196, 168, 228), ("lavender", "lilac", "pale purple", "light purple")),
    NamedColor((212, 32, 142), ("magenta", "fuchsia", "hot pink")),
    NamedColor((246, 166, 190), ("pink", "rose", "pale pink", "light pink")),
    NamedColor((104, 62, 34), ("brown", "chocolate", "dark brown", "chestnut")),
    NamedColor((206, 178, 136), ("beige", "tan", "sand", "light brown")),
    NamedColor((250, 250, 250), ("white", "pure white", "snow white")),
    NamedColor((186, 190, 196), ("light grey", "silver", "light gray", "pale grey")),
    NamedColor((108, 110, 116), ("grey", "gray", "slate", "dark grey")),
    NamedColor((18, 18, 20), ("black", "jet black", "charcoal")),
)
