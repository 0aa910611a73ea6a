"""What transformers read of images: normalised pixels, grids of patches, and their rotary position embedding."""

from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor

from anystyle.errors import UserError

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


@lru_cache(maxsize=256)
def constant(values: tuple[float, ...], device: torch.device, dtype: torch.dtype) -> Float[Tensor, " n"]:
    """Numbers as a tensor, made once: a copy to a card waits for the card."""
    with torch.inference_mode(False):  # a later training reads it, too
        return torch.tensor(values, device=device, dtype=dtype)


def normalised(images: Float[Tensor, "*batch 3 H W"]) -> Float[Tensor, "*batch 3 H W"]:
    """Images in [0, 1], normalised by the ImageNet mean and standard deviation."""
    mean, std = (constant(each, images.device, images.dtype) for each in (IMAGENET_MEAN, IMAGENET_STD))
    return (images - mean[:, None, None]) / std[:, None, None]


def grid_of(images: Float[Tensor, "*batch 3 H W"], patch_size: int) -> tuple[int, int]:
    """Rows and columns of an image's patches."""
    height, width = images.shape[-2:]
    rows, columns = height // patch_size, width // patch_size
    if (height, width) != (rows * patch_size, columns * patch_size) or not rows * columns:
        raise UserError(
            f"images are {height}x{width} pixels; both sides must be multiples of {patch_size}: resize them"
        )
    return rows, columns


class Rotary(NamedTuple):
    """Angles of a sequence of tokens: cosines, and sines with the sign of the pair's first entry folded in."""

    cos: Float[Tensor, "L E"]
    sin: Float[Tensor, "L E"]

    def repeat(self, times: int) -> "Rotary":
        """The angles of a sequence of ``times`` grids, one after the other."""
        return Rotary(self.cos.repeat(times, 1), self.sin.repeat(times, 1))


def grid_positions(grid: tuple[int, int], special: int = 1, device: torch.device | None = None) -> Float[Tensor, "L 2"]:
    """Row and column of a view's tokens: special tokens stand at (0, 0), patches from (1, 1) on."""
    rows, columns = (torch.arange(1.0, 1 + side, device=device) for side in grid)
    places = torch.cartesian_prod(rows, columns)
    return torch.cat([places.new_zeros(special, 2), places])


def rotary(positions: Float[Tensor, "L 2"], dim: int, *, base: float, like: Float[Tensor, "..."]) -> Rotary:
    """Angles of tokens at rows and columns ``positions``, on their device, with the dtype of ``like``.

    The first half of a head's channels turns with the row, the second with the column; entry ``i`` of a half of ``m``
    channels pairs with entry ``i + m / 2`` and turns by ``position * base ** (-2 i / m)``.
    """
    quarter = dim // 4
    frequencies = base ** (-torch.arange(quarter, device=positions.device, dtype=torch.float32) / quarter)
    angles = positions[:, :, None] * frequencies  # L 2 quarter
    sin, cos = angles.sin(), angles.cos()
    return Rotary(
        cos=torch.stack([cos, cos], dim=2).flatten(1).to(like), sin=torch.stack([-sin, sin], dim=2).flatten(1).to(like)
    )


def rotate(x: Float[Tensor, "*batch L E"], angles: Rotary) -> Float[Tensor, "*batch L E"]:
    """Turn each pair of channels by its token's angle."""
    swapped = x.unflatten(-1, (2, 2, -1)).flip(-2).flatten(-3)
    return torch.addcmul(x * angles.cos.to(x.dtype), swapped, angles.sin.to(x.dtype))
