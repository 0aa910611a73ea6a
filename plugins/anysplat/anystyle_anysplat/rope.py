"""Rotary position embedding of image grids (RoPE in two dimensions)."""

from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor


class Rotary(NamedTuple):
    """Angles of a sequence of tokens, ready to rotate queries and keys with.

    Args:
        cos: Cosines.
        sin: Sines, with the sign of the pair's first entry folded in.
    """

    cos: Float[Tensor, "L E"]
    sin: Float[Tensor, "L E"]

    def repeat(self, times: int) -> "Rotary":
        """The angles of a sequence of ``times`` grids, one after the other."""
        return Rotary(self.cos.repeat(times, 1), self.sin.repeat(times, 1))


def grid_rotary(
    grid: tuple[int, int], special: int, dim: int, *, base: float, dtype: torch.dtype, device: torch.device
) -> Rotary:
    """Angles of a view's tokens: special tokens stand at (0, 0), the patch in row y and column x at (y + 1, x + 1).

    The first half of a head's channels turns with the row, the second with the column; entry ``i`` of a half of ``m``
    channels pairs with entry ``i + m / 2`` and turns by ``position * base ** (-2 i / m)``.

    Args:
        grid: Rows and columns of patches.
        special: Tokens ahead of the patches.
        dim: Channels of a head, a multiple of 4.
        base: Of the geometric series of frequencies.
        dtype: Of the result.
        device: Of the result.
    """
    rows, columns = grid
    y = torch.arange(1, rows + 1, device=device)[:, None].expand(rows, columns).flatten()
    x = torch.arange(1, columns + 1, device=device)[None, :].expand(rows, columns).flatten()
    positions = torch.cat([torch.zeros(special, 2, device=device), torch.stack([y, x], dim=-1).float()])  # L 2
    quarter = dim // 4
    frequencies = base ** (-torch.arange(quarter, device=device, dtype=torch.float32) / quarter)
    angles = positions[:, :, None] * frequencies  # L 2 quarter
    sin, cos = angles.sin(), angles.cos()
    return Rotary(
        cos=torch.stack([cos, cos], dim=2).flatten(1).to(dtype),
        sin=torch.stack([-sin, sin], dim=2).flatten(1).to(dtype),
    )


def rotate(x: Float[Tensor, "*batch L E"], rotary: Rotary) -> Float[Tensor, "*batch L E"]:
    """Turn each pair of channels by its token's angle."""
    swapped = x.unflatten(-1, (2, 2, -1)).flip(-2).flatten(-3)
    return x * rotary.cos.to(x.dtype) + swapped * rotary.sin.to(x.dtype)
