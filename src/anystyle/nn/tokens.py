"""What transformers read of images: normalised pixels, grids of patches, and their rotary position embedding."""

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor
from torch.utils._mode_utils import no_dispatch

from anystyle.errors import UserError

IMAGENET_MEAN = (0.485, 0.456, 0.406)
IMAGENET_STD = (0.229, 0.224, 0.225)


@lru_cache(maxsize=256)
def constant(values: tuple[float, ...], device: torch.device, dtype: torch.dtype) -> Float[Tensor, " n"]:
    """Numbers as a tensor, made once: a copy to a card waits for the card."""
    with real():
        return torch.tensor(values, device=device, dtype=dtype)


@contextmanager
def real() -> Iterator[None]:
    """Tensors that are kept have values, also where memory is estimated without, and a later training reads them."""
    with no_dispatch(), torch.inference_mode(False):
        yield


def normalised(images: Float[Tensor, "*batch 3 H W"]) -> Float[Tensor, "*batch 3 H W"]:
    """Images in [0, 1], normalised by the ImageNet mean and standard deviation."""
    mean, std = (constant(each, images.device, images.dtype) for each in (IMAGENET_MEAN, IMAGENET_STD))
    return (images - mean[:, None, None]) / std[:, None, None]


def grid_of(images: Float[Tensor, "*batch 3 H W"], patch_size: int) -> tuple[int, int]:
    """Rows and columns of an image's patches."""
    height, width = images.shape[-2:]
    rows, columns = height // patch_size, width // patch_size
    if (height, width) != (rows * patch_size, columns * patch_size) or not rows * columns:
        raise UserError(f"images are {height}x{width} pixels; sides must be multiples of {patch_size}: resize them")
    return rows, columns


class Rotary(NamedTuple):
    """Angles of a grid's tokens: cosines, and sines with the sign of the pair's first entry folded in.

    The gain of a norm may be in both, and what becomes of its bias is then what is added.
    """

    cos: Float[Tensor, "*heads L E"]
    sin: Float[Tensor, "*heads L E"]
    shift: Float[Tensor, "*heads L E"] | None = None


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


def rotate(x: Float[Tensor, "*batch S E"], angles: Rotary) -> Float[Tensor, "*batch S E"]:
    """Turn each pair of channels by its token's angle; the tokens may be of several grids, one after the other."""
    grids = x.unflatten(-2, (-1, angles.cos.shape[-2]))
    cos, sin = angles.cos.to(x.dtype), angles.sin.to(x.dtype)
    start = grids * cos if angles.shift is None else torch.addcmul(angles.shift.to(x.dtype), grids, cos)
    return torch.addcmul(start, swapped(grids), sin).flatten(-3, -2)


def swapped(x: Float[Tensor, "*batch E"]) -> Float[Tensor, "*batch E"]:
    """Each channel's partner in its place."""
    return x.unflatten(-1, (2, 2, -1)).flip(-2).flatten(-3)
