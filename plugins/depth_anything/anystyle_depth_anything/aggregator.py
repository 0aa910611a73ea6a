"""The later blocks of the trunk: attention alternates between each view and all views."""

from collections.abc import Sequence
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, run, start_as_dino
from anystyle.nn.tokens import Rotary, grid_positions, rotary
from anystyle.types import Features, Inject, Site, Tokens, untouched


class Aggregator(contracts.Aggregator):
    """Blocks that attend across all views where their index in the trunk is odd, and within each view where it is even.

    Style may enter ahead of every block, on the residual stream. Marked as tapped are the first block and, for each
    layer that heads read, the local block whose output is the first half of what they read, so that style is in both
    halves. A tapped feature is the last local block's output and the normalised stream, side by side in the channels;
    its leading token, which cameras are read off, is not normalised.

    Options are explained at :class:`~anystyle_depth_anything.DepthAnything`; ``start`` is ``alternate_from``.
    """

    def __init__(
        self,
        *,
        dim: int,
        start: int,
        depth: int,
        heads: int,
        ffn: Literal["mlp", "swiglu"],
        mlp_ratio: float,
        layer_scale: float,
        rope_base: float,
        taps: Sequence[int],
        checkpointing: bool,
    ) -> None:
        super().__init__()
        self.dim, self.head_dim = dim, dim // heads
        self.start, self.depth = start, depth
        self.taps = tuple(taps)
        self.rope_base = rope_base
        self.checkpointing = checkpointing
        # By their index in the trunk, as checkpoints name them.
        self.blocks = nn.ModuleDict(
            {
                str(layer): Block(
                    dim, heads, mlp_ratio=mlp_ratio, layer_scale=layer_scale, ffn=ffn, qk_norm=True, eps=1e-6
                )
                for layer in range(start, depth)
            }
        )
        self.norm = nn.LayerNorm(dim)
        start_as_dino(self.blocks)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``aggregator/<block>``, ahead of every block."""
        tapped = {self.start, *(max(self.start, layer - layer % 2) for layer in self.taps)}
        return tuple(
            Site(f"aggregator/{layer}", self.dim, tapped=layer in tapped) for layer in range(self.start, self.depth)
        )

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features."""
        batch, views = stem.data.shape[:2]
        within, across = (
            rotary(positions(stem.grid), self.head_dim, base=self.rope_base, like=stem.data)
            for positions in (grid_positions, flat_positions)
        )
        across = across.repeat(views)
        tokens, local = stem, stem.data
        features: dict[int, Tokens] = {}
        for layer in range(self.start, self.depth):
            tokens, block = inject(f"aggregator/{layer}", tokens), self.blocks[str(layer)]
            if layer % 2:
                joint = self._run(block, tokens.data.flatten(1, 2), across)  # B VP C
                tokens = tokens.with_data(joint.unflatten(1, (views, -1)))
            else:
                local = self._run(block, tokens.data.flatten(0, 1), within).unflatten(0, (batch, views))
                tokens = tokens.with_data(local)
            if layer in self.taps:
                features[layer] = self._tapped(local, tokens)
        return features

    def _tapped(self, local: Float[Tensor, "B V P C"], tokens: Tokens) -> Tokens:
        leading = torch.cat([local[:, :, :1], tokens.data[:, :, :1]], dim=-1)
        patches = torch.cat([local[:, :, 1:], self.norm(tokens.patches)], dim=-1)
        return tokens.with_data(torch.cat([leading, patches], dim=2))

    def _run(self, block: nn.Module, x: Float[Tensor, "M L C"], angles: Rotary) -> Float[Tensor, "M L C"]:
        return run(block, x, angles, recompute=self.checkpointing and self.training)


def flat_positions(grid: tuple[int, int]) -> Float[Tensor, "L 2"]:
    """Positions across views, as published: the leading token at (0, 0), every patch at (1, 1)."""
    return grid_positions(grid).clamp_max(1)
