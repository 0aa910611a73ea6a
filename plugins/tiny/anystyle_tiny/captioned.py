"""Captioned pictures for text towers: procedural styles, phrases, palettes, and pictures retouched in known ways."""

from pathlib import Path
from typing import Literal

import torch
from jaxtyping import Float
from kornia.color import rgb_to_grayscale
from torch import Tensor

from anystyle.contracts import StyleSource
from anystyle.data.style_folder import FolderStyles
from anystyle.ranges import AtLeastOne, Count, Fraction
from anystyle.types import Style
from anystyle_tiny.procedural.captions import COLORS, WORDS, join_names
from anystyle_tiny.procedural.layout import SPLITS, Draw, ImageSide
from anystyle_tiny.procedural.patterns import BRUSHWORK, PATTERNS
from anystyle_tiny.procedural.phrases import PHOTO_TEXTS, draw_phrase
from anystyle_tiny.procedural.styles import ProceduralStyles, StyleTraits, draw_palette, paint_style

PHRASES = 0.3125
"""Fraction of phrases among the styles that are not from a folder; the others are procedural."""


class CaptionedPictures(StyleSource):
    """Pictures with captions in natural words, each made when it is read.

    Styles of :class:`ProceduralStyles` in the splits they have there; phrases for things and manners of painting, with
    palettes and patterns that stand for them; and, where folders are given, photographs and paintings as they are, in
    other colours, or covered by a pattern, with words that say so.

    Args:
        size: Height and width in pixels.
        num_styles: How many.
        seed: Seed of the pictures and captions.
        split: Which combinations of procedural styles; of paintings with captions, ``train`` has two thirds.
        photographs: A folder.
        paintings: A folder, with a ``captions.jsonl`` if some are described.
        pictures: How many of the styles are pictures of the folders, from 0 to 1.
        retouch: Whether these are recoloured and covered, or left as they are, but for what is cut out of them; then
            they have a caption only if it is in the folder, and all that have one are in every split.
    """

    def __init__(
        self,
        *,
        size: ImageSide = 256,
        num_styles: AtLeastOne = 12000,
        seed: Count = 0,
        split: Literal["train", "validation", "heldout"] = "train",
        photographs: str | None = None,
        paintings: str | None = None,
        pictures: Fraction = 0.2,
        retouch: bool = True,
    ) -> None:
        self.procedural = ProceduralStyles(size=size, num_styles=num_styles, seed=seed, split=split)
        self.photographs = None if photographs is None else FolderStyles(root=photographs, size=size)
        self.paintings = None if paintings is None else FolderStyles(root=paintings, size=size)
        self.size, self.seed, self.split = size, seed, split
        self.pictures, self.retouch = pictures, retouch

    @classmethod
    def example(cls, folder: Path) -> dict[str, object]:
        return {"size": 32, "num_styles": 8, "paintings": FolderStyles.example(folder)["root"]}

    def __len__(self) -> int:
        return len(self.procedural)

    def read(self, style: int) -> Style:
        draw = Draw((self.seed, SPLITS.index(self.split), style, 11))
        kind, invented = draw.between(0.0, 1.0), 1 - self.pictures
        if kind < invented * (1 - PHRASES) or not 0 <= style < len(self):
            return self.procedural.read(style)
        folders = [folder for folder in (self.photographs, self.paintings) if folder is not None]
        if kind < invented or not folders:
            text, traits = draw_phrase(draw)
            image = paint_style(draw, traits, self.size)
        else:
            text, image = self._from(folders[draw.below(len(folders))], draw)
        return Style(image=image, text=(text,), names=(f"captioned-{self.split}-{self.seed}-{style:05d}",))

    def _from(self, folder: FolderStyles, draw: Draw) -> tuple[str, Float[Tensor, "1 3 H W"]]:
        index = draw.below(len(folder))
        picture = folder.read(index)
        assert picture.image is not None and picture.text is not None
        image, caption = picture.image, picture.text[0]
        if not self.retouch:
            return caption, _crop(draw, image)
        noun = "photo" if folder is self.photographs else "painting"
        if caption and (index % 3 > 0) == (self.split == "train"):
            return caption, _crop(draw, image)
        if folder is self.photographs and draw.chance(0.3):
            return PHOTO_TEXTS[draw.below(1 + draw.below(len(PHOTO_TEXTS)))], _crop(draw, image)
        colors = tuple(draw.below(len(COLORS)) for _ in range(2 + draw.below(2)))
        named = join_names([COLORS[color].names[draw.below(2)] for color in dict.fromkeys(colors)], draw.below)
        recolored = gradient_map(_crop(draw, image), draw_palette(draw, colors))
        if draw.chance(0.5):
            return (f"a {noun} in {named}", f"{named} {noun}")[draw.below(2)], recolored
        pattern = draw.below(len(PATTERNS))
        nouns = WORDS[PATTERNS[pattern]].nouns
        sheet = StyleTraits(pattern, colors, draw.below(3), draw.below(len(BRUSHWORK)), -1, draw_palette(draw, colors))
        covered = 0.4 * recolored + 0.6 * paint_style(draw, sheet, self.size)
        return f"a {noun} in {named} with {nouns[draw.below(len(nouns))]}", covered


def gradient_map(image: Float[Tensor, "1 3 H W"], palette: Float[Tensor, "K 3"]) -> Float[Tensor, "1 3 H W"]:
    """A picture whose darkest pixels have the darkest colour of a palette, the lightest the lightest one."""
    order = rgb_to_grayscale(palette.T[None, :, :, None]).flatten().argsort()
    knots = palette[order]
    luma = rgb_to_grayscale(image).flatten()
    ranks = luma.argsort().argsort().float() / max(1, luma.numel() - 1) * (len(knots) - 1)
    below = ranks.floor().long().clamp_max(len(knots) - 2)
    colors = torch.lerp(knots[below], knots[below + 1], (ranks - below)[:, None])
    return colors.T.reshape(image.shape)


def _crop(draw: Draw, image: Float[Tensor, "1 3 H W"]) -> Float[Tensor, "1 3 H W"]:
    """A square of half the side or more, at full size, perhaps mirrored."""
    side = image.shape[-1]
    keep = int(side * draw.between(0.5, 1.0))
    top, left = draw.below(side - keep + 1), draw.below(side - keep + 1)
    part = image[..., top : top + keep, left : left + keep]
    part = part.flip(-1) if draw.chance(0.5) else part
    return torch.nn.functional.interpolate(part, size=(side, side), mode="bilinear", align_corners=False)
