"""What people would say of a procedural painting."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from anystyle_tiny.procedural.layout import Draw
from anystyle_tiny.procedural.palettes import COLORS

SCALES = ("fine", "medium", "coarse")
DIRECTIONS = ("horizontal", "vertical", "diagonal")


class Words(NamedTuple):
    """Words for a pattern.

    Args:
        nouns: Names in the plural or without an article.
        fine: Adjectives of the finest scale.
        coarse: Adjectives of the coarsest scale.
        things: Whether the nouns are figures on a ground of the palette's first colour.
        directed: Whether a direction can be told.
    """

    nouns: tuple[str, ...]
    fine: tuple[str, ...] = ("small", "fine", "tiny")
    coarse: tuple[str, ...] = ("large", "big", "bold")
    things: bool = False
    directed: bool = False


THIN, BROAD = ("thin", "narrow", "fine"), ("broad", "wide", "thick", "bold")
WORDS: dict[str, Words] = {
    "plain": Words(("colour fields", "plain colour", "flat areas"), ("narrow",), ("broad", "large")),
    "stripes": Words(("stripes", "bands", "striped lines"), THIN, BROAD, directed=True),
    "dots": Words(("dots", "polka dots", "spots"), things=True),
    "mosaic": Words(("mosaic tiles", "mosaic", "mosaic stones", "broken tiles")),
    "checker": Words(("checkerboard squares", "checks", "chequered squares", "checkerboard")),
    "bricks": Words(("bricks", "brickwork", "brick wall pattern"), things=True),
    "hatching": Words(("hatching", "cross-hatching", "hatched lines", "pen hatching"), ("fine", "thin", "dense"), BROAD,
                      things=True),
    "strokes": Words(("brush strokes", "dabs of paint", "brushstrokes", "short strokes"), ("small", "fine", "short"),
                     ("thick", "bold", "broad", "large")),
    "swirls": Words(("swirls", "swirling strokes", "spirals", "whirls"), ("small", "fine", "tight"),
                    ("large", "thick", "bold", "sweeping")),
    "waves": Words(("waves", "wavy lines", "ripples", "wavy stripes"), THIN, BROAD, directed=True),
    "zigzag": Words(("zigzags", "chevrons", "zigzag lines", "zigzag stripes"), THIN, BROAD, directed=True),
    "splatter": Words(("paint splatter", "splashes", "splatters of paint", "blots"), things=True),
    "wash": Words(("gradient", "soft wash", "blurred colours", "smooth gradients"), ("gentle",), ("broad",)),
    "geometric": Words(("geometric shapes", "angular shapes", "cubist shapes", "overlapping shapes")),
    "scales": Words(("fish scales", "scallops", "scales", "overlapping scales")),
    "marble": Words(("marbling", "marbled veins", "marbled paper", "marble pattern"), ("fine", "delicate"),
                    ("large", "bold")),
    "rings": Words(("concentric rings", "rings", "concentric circles", "target circles"), THIN, BROAD),
    "plaid": Words(("plaid", "tartan", "plaid cloth", "tartan weave")),
    "points": Words(("points of paint", "pointillist dots", "stippling", "specks of paint"), ("tiny", "fine"),
                    ("large", "coarse", "bold")),
    "flowers": Words(("flowers", "floral pattern", "blossoms", "petals"), things=True),
}  # fmt: skip

MEDIA: dict[str, tuple[str, ...]] = {
    "print": ("as a crisp print", "in flat paint", "cleanly printed"),
    "oil": ("in oil paint", "in thick impasto", "as an oil painting", "in thick oil paint"),
    "watercolour": ("in watercolour", "as a watercolour", "in soft watercolor", "in wet washes"),
    "chalk": ("in chalk", "in pastel", "in grainy crayon", "as a chalk drawing"),
}


def join_names(names: Sequence[str], below: Callable[[int], int]) -> str:
    """A list of names as people write it."""
    if len(names) == 1:
        return names[0]
    if len(names) == 2:
        return (" and ", " and ", " and ", " with ")[below(4)].join(names)
    return ", ".join(names[:-1]) + (" and ", ", and ")[below(2)] + names[-1]


def describe(
    draw: Draw, *, pattern: str, colors: Sequence[int], scale: int, brushwork: str, direction: str | None
) -> str:
    """One of many natural phrasings.

    Args:
        draw: Chooses among them.
        pattern: A key of WORDS.
        colors: Indices in COLORS, the ground first where there is one.
        scale: Index in SCALES.
        brushwork: A key of MEDIA.
        direction: One of DIRECTIONS, or ``None`` where it shall not be told.
    """
    words, below = WORDS[pattern], draw.below
    names = [COLORS[color].names[below(1 + below(len(COLORS[color].names)))] for color in colors]
    noun = words.nouns[below(len(words.nouns))]
    sizes = (words.fine, (), words.coarse)[scale]
    lead = [sizes[below(len(sizes))]] if sizes and below(5) else []
    lead += [direction] if direction is not None and words.directed else []
    medium = MEDIA[brushwork][below(len(MEDIA[brushwork]))] if below(5) < (1 if brushwork == "print" else 3) else ""
    if words.things and len(names) > 1 and below(2):
        ground, figures = names[0], join_names(names[1:], below)
        setting = (f"on {ground}", f"on a {ground} background", f"over {ground}", f"on a {ground} ground")[below(4)]
        text = " ".join([*lead, figures, noun, setting])
        return _finish(text, medium, below)
    # Where there is no ground to tell, the order of colours is anybody's.
    palette = join_names(draw.shuffled(names), below)
    shape = " ".join([*lead, noun])
    form = below(6)
    if form <= 1:
        text = " ".join([*lead, palette, noun])
    elif form == 2:
        text = f"{shape} in {palette}"
    elif form == 3:
        text = f"{palette}, {shape}"
    elif form == 4:
        text = ("a pattern of ", "a picture of ", "a painting of ", "a design of ")[below(4)]
        text += " ".join([*lead, palette, noun])
    else:
        text = f"{shape}, {palette}"
    return _finish(text, medium, below)


def _finish(text: str, medium: str, below: Callable[[int], int]) -> str:
    if not medium:
        return text
    joint = ", " if "," in text or below(2) else " "
    return f"{text}{joint}{medium}"
