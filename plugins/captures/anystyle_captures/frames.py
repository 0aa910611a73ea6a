"""Frames that all pictures of a capture share, such as the window of screenshots or the bars of a film."""

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from PIL import Image

PICTURES, FEWEST = 12, 3
"""Pictures, evenly spaced, that are compared, and how few say nothing."""
LEVELS = 12
"""Grey levels that compression changes."""
SAME, OTHER = 0.02, 0.5
"""In a frame the share of pixels that differ between pictures is smaller, beside it larger: a sky or a backdrop that is
the same everywhere has no such straight edge."""
BESIDE = slice(4, 12)
"""Pixels behind the edge, those that compression blurs left out."""


def shared_frame(pictures: Sequence[Image.Image]) -> dict[str, float]:
    """How wide a frame is that is the same in all pictures of the most common size, by its sides.

    As shares of the width and height, of sides that have one: ``{"top": 0.1}``.
    """
    (size, number), *_ = Counter(picture.size for picture in pictures).most_common()
    if number < FEWEST:
        return {}
    alike = [picture for picture in pictures if picture.size == size]
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
