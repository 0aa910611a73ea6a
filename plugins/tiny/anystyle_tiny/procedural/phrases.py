"""What things and manners of painting look like, as palettes and patterns, and what people call them."""

import tomllib
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import NamedTuple, TypeVar

from anystyle_tiny.procedural.captions import COLORS, MEDIA, SCALES, WORDS, join_names
from anystyle_tiny.procedural.layout import Draw
from anystyle_tiny.procedural.patterns import BRUSHWORK, PATTERNS
from anystyle_tiny.procedural.styles import DIRECTED, StyleTraits, draw_palette

T = TypeVar("T")

PHOTO_TEXTS = ("a photo", "a photograph", "an ordinary photo", "a realistic photograph")
"""What a photograph as it is may be called, the plainest first."""

FORMS = ("thing", "thing", "manner", "thing by manner", "colors by manner", "thing in pattern", "thing in medium",
         "mood pattern", "mood manner", "colors")  # fmt: skip
"""Kinds of phrases."""


class Appearance(NamedTuple):
    """What words for a thing, a manner or a mood stand for, by indices; empty patterns or brushwork mean any."""

    words: tuple[str, ...]
    colors: tuple[int, ...]
    patterns: tuple[int, ...]
    brushwork: tuple[int, ...]
    scale: int | None


@cache
def appearances(group: str) -> tuple[Appearance, ...]:
    """The ``things``, ``manners`` or ``moods`` of ``phrases.toml``."""
    rows = tomllib.loads(Path(__file__).with_name("phrases.toml").read_text(encoding="utf-8"))[group]
    colors = {color.names[0]: index for index, color in enumerate(COLORS)}
    return tuple(
        Appearance(
            tuple(row["words"]),
            tuple(colors[name] for name in row["colors"]),
            tuple(PATTERNS.index(name) for name in row.get("patterns", ())),
            tuple(BRUSHWORK.index(name) for name in row.get("brushwork", ())),
            row.get("scale"),
        )
        for row in rows.values()
    )


def draw_phrase(draw: Draw) -> tuple[str, StyleTraits]:
    """A phrase, and one of the styles that it stands for."""
    form = _pick(draw, FORMS)
    thing, manner, mood = (_pick(draw, appearances(group)) for group in ("things", "manners", "moods"))
    pattern, brush = draw.below(len(PATTERNS)), draw.below(len(BRUSHWORK))
    noun = _pick(draw, WORDS[PATTERNS[pattern]].nouns)
    medium = _pick(draw, MEDIA[BRUSHWORK[brush]])
    name, method, adjective = (_name(draw, each) for each in (thing, manner, mood))
    if form == "thing":
        before = _pick(draw, ("", "", "", "a painting of ", "a picture of ", "the colours of ", "like "))
        return before + name, _traits(draw, thing, _shuffled(draw, thing.colors, lead=True))
    if form == "manner":
        before = _pick(draw, ("", "", "in the style of ", "a painting by ", "as by "))
        return before + method, _traits(draw, manner, _shuffled(draw, manner.colors, lead=True))
    if form == "thing by manner":
        joint = _pick(draw, (" by ", ", ", " in the style of ", " as ", " "))
        words = f"{name}{joint}{method}" if draw.chance(0.7) else f"{method} {name}"
        return words, _traits(draw, manner, _shuffled(draw, thing.colors, lead=True))
    if form == "thing in pattern":
        words = f"{name}{_pick(draw, (' with ', ' in ', ', '))}{noun}"
        only = thing._replace(patterns=(pattern,), scale=None)
        return words, _traits(draw, only, _shuffled(draw, thing.colors, lead=True))
    if form == "thing in medium":
        words = f"{name}{_pick(draw, (' ', ', '))}{medium}"
        painted = thing._replace(brushwork=(brush,), scale=None)
        return words, _traits(draw, painted, _shuffled(draw, thing.colors, lead=True))
    if form == "mood pattern":
        only = Appearance((), mood.colors, (pattern,), (), None)
        return f"{adjective} {noun}", _traits(draw, only, _shuffled(draw, mood.colors))
    if form == "mood manner":
        return f"{adjective} {method}", _traits(draw, manner, _shuffled(draw, mood.colors))
    colors = _shuffled(draw, range(len(COLORS)))[: 1 + draw.below(3)]
    named = join_names([_pick(draw, COLORS[color].names) for color in colors], draw.below)
    if form == "colors by manner":
        words = f"{named} {method}" if draw.chance(0.5) else f"{method} in {named}"
        return words, _traits(draw, manner, colors)
    before = _pick(draw, ("", "", "all ", "plain ", "shades of ", "a palette of "))
    return before + named, _traits(draw, Appearance((), colors, (), (), None), colors)


def _traits(draw: Draw, appearance: Appearance, colors: tuple[int, ...]) -> StyleTraits:
    """A style of an appearance, in the first two to five of some colours, or in the only one."""
    colors = colors[: 2 + draw.below(4)]
    pattern = _pick(draw, appearance.patterns or range(len(PATTERNS)))
    scale = draw.below(len(SCALES)) if appearance.scale is None else appearance.scale
    brushwork = _pick(draw, appearance.brushwork or range(len(BRUSHWORK)))
    direction = draw.below(3) if PATTERNS[pattern] in DIRECTED else -1
    return StyleTraits(pattern, colors, scale, brushwork, direction, draw_palette(draw, colors))


def _shuffled(draw: Draw, colors: Sequence[int], *, lead: bool = False) -> tuple[int, ...]:
    """Colours in another order; with ``lead`` the first one stays the ground more often than not."""
    order = draw.shuffled(colors)
    if lead and draw.chance(0.6):
        order.remove(colors[0])
        order.insert(0, colors[0])
    return tuple(order)


def _name(draw: Draw, appearance: Appearance) -> str:
    """One of its words, the plainest most often."""
    return appearance.words[draw.below(1 + draw.below(len(appearance.words)))]


def _pick(draw: Draw, options: Sequence[T]) -> T:
    return options[draw.below(len(options))]
