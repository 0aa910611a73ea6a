"""VGGT's alternating attention: within each view, then across all views."""

from collections.abc import Sequence

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, run
from anystyle.nn.tokens import Rotary, grid_positions, rotary
from anystyle.types import Features, Inject, Site, Tokens, untouched


class Aggregator(contracts.Aggregator):
    """Pairs of a frame block, which sees one view, and a global block, which sees all.

    Style may enter ahead of every pair, on the residual stream; the published method uses the first layer and those
    that heads read. A tapped feature is the outputs of both blocks of the layer, side by side in the channels.

    Options are explained at :class:`~anystyle_anysplat.AnySplat`.
    """

    def __init__(
        self,
        *,
        dim: int,
        depth: int,
        heads: int,
        mlp_ratio: float,
        layer_scale: float,
        rope_base: float,
        taps: Sequence[int],
        checkpointing: bool,
    ) -> None:
        super().__init__()
        self.dim, self.head_dim = dim, dim // heads
        self.taps = tuple(taps)
        self.rope_base = rope_base
        self.checkpointing = checkpointing

        def blocks() -> nn.ModuleList:
            return nn.ModuleList(
                Block(dim, heads, mlp_ratio=mlp_ratio, layer_scale=layer_scale, qk_norm=True) for _ in range(depth)
            )

        self.frame_blocks = blocks()
        self.global_blocks = blocks()

    @property
    def sites(self) -> tuple[Site, ...]:
        """``aggregator/<layer>`` for every layer."""
        return tuple(
            Site(f"aggregator/{layer}", self.dim, tapped=layer == 0 or layer in self.taps)
            for layer in range(len(self.frame_blocks))
        )

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features; no other layer's output is kept."""
        views = stem.data.shape[1]
        positions = grid_positions(stem.grid, stem.special)
        within = rotary(positions, self.head_dim, base=self.rope_base, like=stem.data)
        across = within.repeat(views)
        features: dict[int, Tokens] = {}
        tokens = stem
        for layer, (frame_block, global_block) in enumerate(zip(self.frame_blocks, self.global_blocks, strict=True)):
            tokens = inject(f"aggregator/{layer}", tokens)
            batch, _, count, _ = tokens.data.shape
            framed = self._run(frame_block, tokens.data.flatten(0, 1), within)  # BV P C
            joint = self._run(global_block, framed.unflatten(0, (batch, views)).flatten(1, 2), across)  # B VP C
            tokens = tokens.with_data(joint.unflatten(1, (views, count)))
            if layer in self.taps:
                features[layer] = tokens.with_data(
                    torch.cat([framed.unflatten(0, (batch, views)), tokens.data], dim=-1)
                )
        return features

    def _run(self, block: nn.Module, x: Float[Tensor, "M L C"], angles: Rotary) -> Float[Tensor, "M L C"]:
        return run(block, x, angles, recompute=self.checkpointing and self.training)
