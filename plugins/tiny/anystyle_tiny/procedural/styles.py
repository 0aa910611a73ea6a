"""Captioned paintings made on the fly: palettes x patterns x scales x brushwork."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.contracts import StyleSource
from anystyle.errors import UserError
from anystyle.ranges import AtLeastOne, Count, Range
from anystyle.types import Style
from anystyle_tiny.procedural.captions import COLORS, DIRECTIONS, SCALES, describe
from anystyle_tiny.procedural.layout import SPLITS, Draw, ImageSide, unit_circle
from anystyle_tiny.procedural.patterns import BRUSHWORK, FREQUENCY, PATTERNS, WASH, paint
from anystyle_tiny.procedural.volumes import scramble, volumes

# One of every HOLD combinations of colours with a pattern is never seen in training.
HOLD = 6
# Patterns that look the same upside down turn freely; the others keep a direction that a caption may tell.
DIRECTED = ("stripes", "waves", "zigzag")
UPRIGHT = ("bricks", "scales", "plaid", "wash", "plain")
# Turns of the directions, and periods of the scales as a fraction of the middle one's.
TURN = (0.0, 0.5 * np.pi, 0.25 * np.pi)
SCALE = (1.7, 1.0, 0.59)


@dataclass(frozen=True)
class StyleTraits:
    """What a procedural style was made of, by indices in the tables of those names."""

    pattern: int
    colors: tuple[int, ...]  # the ground comes first
    scale: int
    brushwork: int
    direction: int  # or -1
    palette: Float[Tensor, "K 3"]  # sRGB in [0, 1], at least two rows


class ProceduralStyles(StyleSource):
    """Pictures of a pattern in one to three colours with a caption in natural words, each made when it is read.

    Combinations of a set of colours with a pattern are split: those of ``heldout`` occur in no other split.

    Args:
        size: Height and width in pixels.
        num_styles: How many styles.
        seed: Seed of the pictures and captions; which combinations are held out does not depend on it.
        split: Which combinations, and which pictures of them.
        max_colors: The most colours a picture has.
    """

    def __init__(
        self,
        *,
        size: ImageSide = 64,
        num_styles: AtLeastOne = 20000,
        seed: Count = 0,
        split: Literal["train", "validation", "heldout"] = "train",
        max_colors: Annotated[int, Range(ge=1, le=3)] = 3,
    ) -> None:
        self.size, self.num_styles, self.seed, self.split = size, num_styles, seed, split
        self.max_colors = max_colors

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"size": 32, "num_styles": 8}

    def __len__(self) -> int:
        return self.num_styles

    def read(self, style: int) -> Style:
        draw, traits = self._draw(style)
        directed = PATTERNS[traits.pattern] in DIRECTED
        direction = DIRECTIONS[traits.direction] if directed and draw.chance(0.5) else None
        text = describe(
            draw, PATTERNS[traits.pattern], traits.colors, traits.scale, BRUSHWORK[traits.brushwork], direction
        )
        image = paint_style(draw, traits, self.size)
        return Style(image=image, text=(text,), names=(f"{self.split}-{self.seed}-{style:05d}",))

    def _draw(self, style: int) -> tuple[Draw, StyleTraits]:
        if not 0 <= style < self.num_styles:
            raise UserError(f"style {style}: there are {self.num_styles}, counted from 0")
        draw = Draw((self.seed, SPLITS.index(self.split), style, 7))
        while True:
            pattern = draw.below(len(PATTERNS))
            colors = _colors(draw, 1 + (min(draw.below(4), 2) if self.max_colors == 3 else draw.below(self.max_colors)))
            if is_held_out(pattern, colors) == (self.split == "heldout"):
                break
        name = PATTERNS[pattern]
        direction = draw.below(len(DIRECTIONS)) if name in DIRECTED else -1
        scale, brushwork = draw.below(len(SCALES)), draw.below(len(BRUSHWORK))
        palette = draw_palette(draw, colors, plain=name == "plain")
        return draw, StyleTraits(pattern, colors, scale, brushwork, direction, palette)


def is_held_out(pattern: int, colors: tuple[int, ...]) -> bool:
    """Whether a combination is kept from training, whatever the order of its colours."""
    mask = sum(1 << color for color in colors)
    return int(scramble(int(scramble(mask + 1)) + 7919 * (pattern + 1))) % HOLD == 0


def _colors(draw: Draw, count: int) -> tuple[int, ...]:
    """Colours that are clearly different from each other."""
    chosen: list[int] = []
    while len(chosen) < count:
        color = draw.below(len(COLORS))
        if all(np.linalg.norm(np.subtract(COLORS[color].rgb, COLORS[other].rgb)) > 90 for other in chosen):
            chosen.append(color)
    return tuple(chosen)


def draw_palette(draw: Draw, colors: tuple[int, ...], *, plain: bool = False) -> Float[Tensor, "K 3"]:
    """Shades of named colours, each near its colour; at least two rows, a single colour with a shade of it."""
    rows = []
    for color in colors:
        jitter = [draw.between(-0.035, 0.035) for _ in range(3)]
        rows.append(np.clip(np.array(COLORS[color].rgb) / 255.0 + jitter, 0.0, 1.0))
    if len(rows) == 1:
        # One colour shows its pattern by a shade of itself: darker where it is light, lighter where it is dark.
        light = float(rows[0].mean())
        amount = draw.between(0.3, 0.5) * (0.2 if plain else 1.0)
        rows.append(rows[0] * (1 - amount) if light > 0.35 else rows[0] + (1 - rows[0]) * 0.7 * amount)
        if draw.chance(0.5):
            rows.reverse()
    return torch.from_numpy(np.stack(rows)).float()


def paint_style(draw: Draw, traits: StyleTraits, size: int) -> Float[Tensor, "1 3 H W"]:
    """One of the pictures that have these traits."""
    name = PATTERNS[traits.pattern]
    if traits.direction >= 0:
        rising = draw.chance(0.5)
        angle = TURN[traits.direction] * (1 if rising or DIRECTIONS[traits.direction] != "diagonal" else -1)
        angle += draw.between(-0.12, 0.12)
    elif name in UPRIGHT:
        angle = draw.between(-0.12, 0.12) + (np.pi if traits.pattern == WASH and draw.chance(0.5) else 0.0)
    else:
        angle = draw.between(-np.pi, np.pi)
    frequency = FREQUENCY[traits.pattern] * SCALE[traits.scale] * draw.between(0.85, 1.15)
    image, turn, palette = np.empty((size, size, 3)), np.array(unit_circle(angle)), traits.palette.double().numpy()
    # A wash runs once through its palette: from where it begins.
    offset = [0.0, 0.0] if traits.pattern == WASH else [draw.between(0.0, 16.0), draw.between(0.0, 16.0)]
    salt = draw.below(1 << 16)
    paint(traits.pattern, traits.brushwork, frequency, turn, np.array(offset), palette, salt, volumes(), image)
    levels = torch.from_numpy((image * 255.0 + 0.5).astype(np.uint8))
    return (levels.permute(2, 0, 1)[None].float() / 255.0).contiguous()
