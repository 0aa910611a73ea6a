"""Frames that all pictures of a capture share, such as the window of screenshots or the bars of a film."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image

from anystyle.types import Original, SourceImage

PICTURES, FEWEST = 12, 3
"""Pictures, evenly spaced, that are compared, and how few say nothing."""
LEVELS = 12
"""Grey levels that compression changes."""
SAME, OTHER = 0.02, 0.5
"""In a frame the share of pixels that differ between pictures is smaller, beside it larger: a sky or a backdrop that is
the same everywhere has no such straight edge."""
BESIDE = slice(4, 12)
"""Pixels behind the edge, those that compression blurs left out."""
LEAST = 0.5
"""Of the width and the height that a frame leaves; one that leaves less is not cut off."""


def shared_frame(pictures: Sequence[Image.Image]) -> dict[str, float]:
    """How wide a frame is that is the same in all pictures of the most common size, by its sides.

    As shares of the width and height, of sides that have one: ``{"top": 0.1}``.
    """
    size = most_common_size(pictures)
    alike = [picture for picture in pictures if picture.size == size]
    if (number := len(alike)) < FEWEST:
        return {}
    chosen = np.linspace(0, number - 1, min(number, PICTURES)).round().astype(int)
    grey = np.stack([np.asarray(alike[index].convert("L")) for index in chosen])
    differs: Bool[np.ndarray, "H W"] = grey.max(0) - grey.min(0) > LEVELS
    # The columns are looked at within the rows of the content, and these within its columns.
    top, bottom = _edges(differs.mean(1))
    left, right = _edges(differs[top : len(differs) - bottom].mean(0))
    top, bottom = _edges(differs[:, left : differs.shape[1] - right].mean(1))
    width, height = size
    shares = {"left": left / width, "top": top / height, "right": right / width, "bottom": bottom / height}
    return {side: share for side, share in shares.items() if share}


def _edges(differing: Float[np.ndarray, " N"]) -> tuple[int, int]:
    return _edge(differing), _edge(differing[::-1])


def _edge(differing: Float[np.ndarray, " N"]) -> int:
    """How many lines from the border on are the same in all pictures, if the content begins along a whole line."""
    inside = np.flatnonzero(differing > SAME)
    width = int(inside[0]) if len(inside) else 0
    beside = differing[width:][BESIDE]
    return width if len(beside) and beside.mean() > OTHER else 0


class Inner(NamedTuple):
    """What of a photograph lies in its frame: left, top, right and bottom as shares of its width and height."""

    left: float
    top: float
    right: float
    bottom: float

    @classmethod
    def of(cls, frame: Mapping[str, float]) -> "Inner":
        """The inside of a :func:`shared_frame`."""
        left, top, right, bottom = (frame.get(side, 0.0) for side in cls._fields)
        return cls(left, top, 1 - right, 1 - bottom)

    @property
    def large(self) -> bool:
        """Whether it is at least :data:`LEAST` of the width and of the height."""
        return min(self.right - self.left, self.bottom - self.top) >= LEAST

    def pixels(self, width: int, height: int) -> tuple[int, int, int, int]:
        """Its box in a picture of a size."""
        return (
            round(self.left * width),
            round(self.top * height),
            round(self.right * width),
            round(self.bottom * height),
        )

    def original(self, original: Original) -> Original:
        """A photograph without its frame."""
        left, top, right, bottom = self.pixels(original.size[1], original.size[0])
        box, mask = self.pixels(*original.picture.size), original.mask
        return original._replace(
            size=(bottom - top, right - left),
            picture=original.picture.crop(box),
            mask=None if mask is None else mask.crop(box),
        )

    def source(self, inner: SourceImage, size: tuple[int, int]) -> SourceImage:
        """A view of a photograph without its frame, as one of the whole, whose height and width are given."""
        x, y, *_ = self.pixels(size[1], size[0])
        left, top, right, bottom = inner.box
        straight = None if inner.straightened is None else self._straightened(inner.straightened)
        return replace(inner, size=size, box=(left + x, top + y, right + x, bottom + y), straightened=straight)

    def _straightened(self, straighten: Callable[[Image.Image], Image.Image]) -> Callable[[Image.Image], Image.Image]:
        """The same for a picture with a frame, which stays where it is."""

        def within(picture: Image.Image) -> Image.Image:
            box = self.pixels(*picture.size)
            straight = straighten(picture.crop(box))
            whole = picture.convert(straight.mode)
            whole.paste(straight.resize((box[2] - box[0], box[3] - box[1])), box[:2])
            return whole

        return within


def most_common_size(pictures: Sequence[Image.Image]) -> tuple[int, int]:
    """The width and height that most pictures have."""
    return Counter(picture.size for picture in pictures).most_common(1)[0][0]
