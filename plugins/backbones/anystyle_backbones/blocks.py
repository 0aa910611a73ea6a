"""How networks begin and run transformer blocks, and angles in which a pass of them is fewer kernels."""

from collections.abc import Iterable
from functools import lru_cache

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from anystyle.nn.attention import Attention
from anystyle.nn.tokens import Rotary, grid_positions, real, rotary, swapped


@lru_cache(maxsize=64)
def grid_rotary(
    grid: tuple[int, int], special: int, dim: int, base: float, device: torch.device, dtype: torch.dtype
) -> Rotary:
    """Angles of a view's tokens, at :func:`~anystyle.nn.tokens.grid_positions`, kept: they depend on sizes alone."""
    with real():
        places = grid_positions(grid, special, device)
        return rotary(places, dim, base=base, like=places.new_empty(0, dtype=dtype))


def with_norms(blocks: Iterable[nn.Module], angles: Rotary) -> list[Rotary]:
    """For each :class:`Attention` in blocks the angles, with the gain and bias of its norms of queries and keys."""
    layers = [layer for block in blocks for layer in block.modules() if isinstance(layer, Attention)]
    norms = [norm for layer in layers for norm in (layer.q_norm, layer.k_norm)]
    gain, bias = (
        torch.stack([getattr(norm, name) for norm in norms]).unflatten(0, (-1, 1, 2)) for name in ("weight", "bias")
    )  # each N 1 2 E
    cos, sin = angles.cos[:, None], angles.sin[:, None]
    tables = gain * cos, swapped(gain) * sin, torch.addcmul(bias * cos, swapped(bias), sin)  # N L 2 E
    # The memory's order is that of queries and keys, which else would be copied.
    return list(map(Rotary, *(table.transpose(1, 2)[:, :, None, None] for table in tables)))


def start_as_dino(module: nn.Module) -> None:
    """Initialise the linear layers of blocks as DINOv2 does."""
    for layer in module.modules():
        if isinstance(layer, nn.Linear):
            nn.init.trunc_normal_(layer.weight, std=0.02)
            nn.init.zeros_(layer.bias)


def run(
    block: nn.Module, x: Float[Tensor, "M L C"], angles: Rotary | None = None, *, recompute: bool
) -> Float[Tensor, "M L C"]:
    """A block's tokens; with ``recompute`` activations are recomputed in the backward pass (gradient checkpointing)."""
    if recompute and torch.is_grad_enabled():
        return checkpoint(block, x, angles, use_reentrant=False)
    return block(x, angles)
