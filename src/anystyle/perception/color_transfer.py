"""Colours of one set of pixels matched to those of another by an affine map (ARF, Zhang et al. 2022, section 4.3)."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

FLOOR = 1e-6
"""Variances are at least this: a direction without any colour has no scale."""


class ColorMap(NamedTuple):
    """``matrix c + offset`` of colours ``c``.

    Args:
        matrix: Positive square roots of covariances, so that hues turn as little as can be.
        offset: Moves the mean.
    """

    matrix: Float[Tensor, "3 3"]
    offset: Float[Tensor, "3"]

    def __call__(self, colors: Float[Tensor, "*batch 3"]) -> Float[Tensor, "*batch 3"]:
        """The colours, not cut."""
        return colors @ self.matrix.T + self.offset

    def of_images(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M 3 H W"]:
        """The images, cut to [0, 1]."""
        return self(images.movedim(1, -1)).clamp(0, 1).movedim(-1, 1)


def color_map(content: Float[Tensor, "M 3 H W"], style: Float[Tensor, "1 3 h w"]) -> ColorMap:
    """The map that gives the pixels of all contents together the mean and the covariance of the style's.

    ``A = S_style^(1/2) S_content^(-1/2)`` and ``b = m_style - A m_content`` with means ``m`` and covariances ``S``.
    """
    (mean, root), (style_mean, style_root) = (_moments(images) for images in (content, style))
    matrix = style_root @ torch.linalg.inv(root)
    return ColorMap(matrix.to(content), (style_mean - matrix @ mean).to(content))


def _moments(images: Tensor) -> tuple[Float[Tensor, "3"], Float[Tensor, "3 3"]]:
    """Mean, and the symmetric square root of the covariance."""
    pixels = images.movedim(1, 0).flatten(1).double()  # 3 S
    values, vectors = torch.linalg.eigh(pixels.cov())
    return pixels.mean(1), vectors @ values.clamp_min(FLOOR).sqrt().diag() @ vectors.T
