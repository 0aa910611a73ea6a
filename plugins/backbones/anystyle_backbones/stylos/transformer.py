"""The style aggregator: views attend to one another and to the tokens of a style image."""

from collections.abc import Sequence
from functools import partial
from itertools import repeat
from typing import Literal, NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.utils.checkpoint import checkpoint

from anystyle.nn.attention import Attention, LayerScale, Mlp, attended
from anystyle.nn.tokens import Rotary, grid_positions, rotary, rotate
from anystyle.types import Features, Inject, Tokens, untouched
from anystyle_backbones.anysplat.networks import Aggregator
from anystyle_backbones.blocks import with_norms

STEM = -1
"""The key of the stem among the features, ahead of all layers'."""
SITES = "head/style_aggregator"
Order = Literal["global", "frame", "hybrid"]
KINDS = {"global": ("global",), "frame": ("frame",), "hybrid": ("global", "frame")}
"""The blocks of a layer, in the order of the computation."""


class StemAggregator(Aggregator):
    """AnySplat's aggregator, whose features hold the stem as well, at :data:`STEM`: colours start from it."""

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        return {STEM: stem, **super().forward(stem, inject)}


class Angles(NamedTuple):
    """Rotary angles of a view's tokens, with the norms of a block's own attention and without, and of the style's."""

    own: Rotary
    view: Rotary
    style: Rotary


class StyleAttention(nn.Module):
    """Multi-head attention of views to a style; queries and keys are normalised per head, ahead of the rotation."""

    def __init__(self, dim: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q_proj = nn.Linear(dim, dim)
        self.kv_proj = nn.Linear(dim, 2 * dim)
        self.q_norm, self.k_norm = nn.LayerNorm(dim // heads), nn.LayerNorm(dim // heads)
        self.proj = nn.Linear(dim, dim)

    def forward(
        self, x: Float[Tensor, "B L C"], style: Float[Tensor, "B S C"], angles: Angles
    ) -> Float[Tensor, "B L C"]:
        q = self.q_norm(self.q_proj(x).unflatten(-1, (self.heads, -1)).transpose(1, 2))  # B heads L E
        k, v = self.kv_proj(style).unflatten(-1, (2, self.heads, -1)).permute(2, 0, 3, 1, 4)  # each B heads S E
        q, k = rotate(q, angles.view), rotate(self.k_norm(k), angles.style)
        # Under autocast the norms leave queries and keys in another precision than values.
        return self.proj(attended(q, k, v))


class CrossBlock(nn.Module):
    """Attention within or across views, then to the style, then a feed-forward layer.

    Args:
        dim: Channels.
        heads: Attention heads.
        across: Whether views see one another.
    """

    def __init__(self, dim: int, heads: int, *, across: bool) -> None:
        super().__init__()
        self.across = across
        self.norm1, self.qnorm1, self.kvnorm1, self.norm2 = (nn.LayerNorm(dim) for _ in range(4))
        self.attn = Attention(dim, heads, qk_norm=True)
        self.cross_attn = StyleAttention(dim, heads)
        self.mlp = Mlp(dim, 4 * dim, dim)
        self.ls1, self.ls2, self.ls3 = (LayerScale(dim, 0.01) for _ in range(3))

    def forward(
        self, x: Float[Tensor, "B V P C"], style: Float[Tensor, "B S C"], angles: Angles
    ) -> Float[Tensor, "B V P C"]:
        start = int(self.across)
        x = self.ls1(x, self.attn(self.norm1(x).flatten(start, start + 1), angles.own).view_as(x))
        # Each token attends for itself, so all views of a scene are one sequence.
        x = self.ls2(x, self.cross_attn(self.qnorm1(x).flatten(1, 2), self.kvnorm1(style), angles).view_as(x))
        return self.ls3(x, self.mlp(self.norm2(x)))


class StyleAggregator(nn.Module):
    """From the stem and the patches of a style image to the tokens that colours are decoded from.

    The style has register tokens of its own and keeps its own grid; no layer changes it. Where a layer has two blocks,
    their outputs lie side by side, the later one's first.

    Options are explained at :class:`~anystyle_backbones.stylos.Stylos`; ``registers`` are tokens of the style.
    """

    def __init__(
        self,
        dim: int,
        heads: int,
        *,
        depth: int,
        order: Order,
        taps: Sequence[int],
        checkpointing: bool,
        registers: int = 4,
    ) -> None:
        super().__init__()
        self.taps, self.checkpointing, self.head_dim = tuple(taps), checkpointing, dim // heads
        self.register_token = nn.Parameter(torch.empty(1, 1, registers, dim))
        nn.init.normal_(self.register_token, std=1e-6)

        def block(kind: str) -> CrossBlock:
            return CrossBlock(dim, heads, across=kind == "global")

        self.layers = nn.ModuleList(nn.ModuleDict({kind: block(kind) for kind in KINDS[order]}) for _ in range(depth))

    def forward(self, stem: Tokens, style: Tokens, inject: Inject = untouched) -> list[Tokens]:
        """The tapped tokens, the earliest first, of views whose style is the patches of one view."""
        registers, patches = self.register_token[:, 0], style.patches[:, 0]
        styles = torch.cat([registers.expand(len(patches), -1, -1).to(patches.dtype), patches], dim=1)
        turned = partial(rotary, dim=self.head_dim, base=100.0, like=stem.data)
        view = turned(grid_positions(stem.grid, stem.special, stem.data.device))
        of_style = turned(grid_positions(style.grid, registers.shape[1], stem.data.device))
        angles = map(Angles, with_norms(self.layers, view), repeat(view), repeat(of_style))
        tapped, tokens = [], stem
        for number, layer in enumerate(self.layers):
            tokens, outputs = inject(f"{SITES}/{number}", tokens), []
            assert isinstance(layer, nn.ModuleDict)
            for block in layer.values():
                if self.checkpointing and self.training and torch.is_grad_enabled():
                    data = checkpoint(block, tokens.data, styles, next(angles), use_reentrant=False)
                else:
                    data = block(tokens.data, styles, next(angles))
                tokens = tokens.with_data(data)
                outputs.insert(0, data)
            if number in self.taps:
                tapped.append(tokens.with_data(torch.cat(outputs, dim=-1)))
        return tapped
