"""What things and manners of painting look like, as palettes and patterns, and what people call them."""

import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TypeVar

from anystyle_tiny.procedural.captions import DIRECTIONS, MEDIA, SCALES, WORDS, describe, join_names
from anystyle_tiny.procedural.layout import Draw
from anystyle_tiny.procedural.painting import BRUSHWORK
from anystyle_tiny.procedural.palettes import COLORS
from anystyle_tiny.procedural.patterns import PATTERNS
from anystyle_tiny.procedural.styles import DIRECTED, StyleTraits, draw_palette

T = TypeVar("T")

PHOTO_TEXTS = ("a photo", "a photograph", "an ordinary photo", "a realistic photograph")
"""What a photograph as it is may be called, the plainest first."""

FORMS = ("thing", "thing", "manner", "thing by manner", "colors by manner", "thing in pattern", "thing in medium",
         "mood pattern", "mood manner", "colors")  # fmt: skip
"""Kinds of phrases."""


@dataclass(frozen=True)
class Look:
    """What words for a look stand for.

    Args:
        words: Names, the plainest first.
        colors: Indices in :data:`anystyle_tiny.procedural.palettes.COLORS`.
        patterns: Indices in :data:`anystyle_tiny.procedural.patterns.PATTERNS`; empty where any will do.
        brushwork: Indices in :data:`anystyle_tiny.procedural.painting.BRUSHWORK`.
        scale: Index in :data:`anystyle_tiny.procedural.captions.SCALES`; ``None`` for any.
    """

    words: tuple[str, ...]
    colors: tuple[int, ...]
    patterns: tuple[int, ...]
    brushwork: tuple[int, ...]
    scale: int | None


@cache
def looks(group: str) -> tuple[Look, ...]:
    """The ``things``, ``manners`` or ``moods`` of ``phrases.toml``."""
    rows = tomllib.loads(Path(__file__).with_name("phrases.toml").read_text(encoding="utf-8"))[group]
    colors = {color.names[0]: index for index, color in enumerate(COLORS)}
    return tuple(
        Look(
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
    thing, manner, mood = (_pick(draw, looks(group)) for group in ("things", "manners", "moods"))
    pattern, brush = draw.below(len(PATTERNS)), draw.below(len(BRUSHWORK))
    noun = _pick(draw, WORDS[PATTERNS[pattern]].nouns)
    medium = _pick(draw, MEDIA[BRUSHWORK[brush]])
    name, method, adjective = (_name(draw, look) for look in (thing, manner, mood))
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
        only = Look((), thing.colors, (pattern,), thing.brushwork, None)
        return words, _traits(draw, only, _shuffled(draw, thing.colors, lead=True))
    if form == "thing in medium":
        words = f"{name}{_pick(draw, (' ', ', '))}{medium}"
        painted = Look((), thing.colors, thing.patterns, (brush,), None)
        return words, _traits(draw, painted, _shuffled(draw, thing.colors, lead=True))
    if form == "mood pattern":
        only = Look((), mood.colors, (pattern,), (), None)
        return f"{adjective} {noun}", _traits(draw, only, _shuffled(draw, mood.colors))
    if form == "mood manner":
        return f"{adjective} {method}", _traits(draw, manner, _shuffled(draw, mood.colors))
    colors = _shuffled(draw, range(len(COLORS)))[: 1 + draw.below(3)]
    named = join_names([_pick(draw, COLORS[color].names) for color in colors], draw.below)
    if form == "colors by manner":
        words = f"{named} {method}" if draw.chance(0.5) else f"{method} in {named}"
        return words, _traits(draw, manner, colors)
    before = _pick(draw, ("", "", "all ", "plain ", "shades of ", "a palette of "))
    return before + named, _traits(draw, Look((), colors, (), (), None), colors)


def descriptions(num_captions: int = 500) -> tuple[str, ...]:
    """Texts that together have every word of captions and phrases: single looks and names, then whole captions."""
    names = [word for group in ("things", "manners", "moods") for look in looks(group) for word in look.words]
    names += [name for color in COLORS for name in color.names]
    names += [noun for words in WORDS.values() for noun in words.nouns]
    names += [f"{size} {words.nouns[0]}" for words in WORDS.values() for size in words.fine + words.coarse]
    names += [f"{colors} {medium}" for colors in ("red", "blue") for media in MEDIA.values() for medium in media]
    names += PHOTO_TEXTS
    draw = Draw((16,))
    for _ in range(num_captions):
        pattern = PATTERNS[draw.below(len(PATTERNS))]
        colors = _shuffled(draw, range(len(COLORS)))[: 1 + draw.below(3)]
        direction = _pick(draw, DIRECTIONS) if pattern in DIRECTED else None
        names.append(
            describe(
                draw,
                pattern=pattern,
                colors=colors,
                scale=draw.below(len(SCALES)),
                brushwork=_pick(draw, BRUSHWORK),
                direction=direction,
            )
        )
    names += [draw_phrase(draw)[0] for _ in range(num_captions)]
    return tuple(dict.fromkeys(names))


def _traits(draw: Draw, look: Look, colors: tuple[int, ...]) -> StyleTraits:
    """A style with a look, in the first two to five of some colours, or in the only one."""
    colors = colors[: 2 + draw.below(4)]
    pattern = _pick(draw, look.patterns or range(len(PATTERNS)))
    return StyleTraits(
        pattern=pattern,
        colors=colors,
        scale=draw.below(len(SCALES)) if look.scale is None else look.scale,
        brushwork=_pick(draw, look.brushwork or range(len(BRUSHWORK))),
        direction=draw.below(3) if PATTERNS[pattern] in DIRECTED else -1,
        palette=draw_palette(draw, colors),
    )


def _shuffled(draw: Draw, colors: Sequence[int], *, lead: bool = False) -> tuple[int, ...]:
    """Colours in another order; with ``lead`` the first one stays the ground more often than not."""
    order = draw.shuffled(colors)
    if lead and draw.chance(0.6):
        order.remove(colors[0])
        order.insert(0, colors[0])
    return tuple(order)


def _name(draw: Draw, look: Look) -> str:
    """One of its words, the plainest most often."""
    return look.words[draw.below(1 + draw.below(len(look.words)))]


def _pick(draw: Draw, options: Sequence[T]) -> T:
    return options[draw.below(len(options))]
