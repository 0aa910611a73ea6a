"""Features of photographs, and the matches of pairs."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

Array = np.ndarray


@dataclass(frozen=True)
class Features:
    """Features of one photograph in pixels of its enlargement.

    Args:
        keypoints: x, y, scale and orientation.
        descriptors: Of unit norm.
    """

    keypoints: Float[Array, "N 4"]
    descriptors: Float[Array, "N 128"]


@dataclass(frozen=True)
class VerifiedPair:
    """Two photographs with matches that one motion of a rigid scene explains.

    Args:
        first: Index of a photograph.
        second: Likewise.
        pixels: Where each match is in the first and in the second, in pixels of their enlargements.
    """

    first: int
    second: int
    pixels: Float[Array, "2 M 2"]
