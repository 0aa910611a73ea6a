"""From photographs to tokens: DINOv2 with registers, then VGGT's attention within each view and across all."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block, run, start_as_dino
from anystyle.nn.tokens import Rotary, grid_of, grid_positions, normalised, rotary
from anystyle.types import Features, Inject, Site, Tokens, untouched
from anystyle_backbones.reference_view import Strategy, is_reference, reference_view


class DinoV2(nn.Module):
    """DINOv2's vision transformer with registers.

    ``grid`` is the side, in patches, that position embeddings are stored for; ``registers`` are dropped at the end.
    """

    def __init__(
        self, *, dim: int, depth: int, heads: int, patch_size: int, grid: int, mlp_ratio: float, registers: int = 4
    ) -> None:
        super().__init__()
        self.grid = grid
        self.proj = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        self.cls_token = nn.Parameter(torch.empty(1, 1, dim))
        self.register_tokens = nn.Parameter(torch.empty(1, registers, dim))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(
            Block(dim, heads, mlp_ratio=mlp_ratio, layer_scale=1.0, eps=1e-6) for _ in range(depth)
        )
        self.norm = nn.LayerNorm(dim, eps=1e-6)
        nn.init.normal_(self.cls_token, std=1e-6)
        nn.init.normal_(self.register_tokens, std=1e-6)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        start_as_dino(self)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        """Embed normalised images; only the patches' tokens are returned, in row-major order."""
        patches = self.proj(images)
        positions = self.positions((patches.shape[-2], patches.shape[-1])).to(patches.dtype)
        tokens = torch.cat([self.cls_token.expand(len(images), -1, -1), patches.flatten(2).mT], dim=1) + positions
        registers = self.register_tokens.expand(len(images), -1, -1)
        tokens = torch.cat([tokens[:, :1], registers, tokens[:, 1:]], dim=1)
        for block in self.blocks:
            tokens = block(tokens)
        return self.norm(tokens)[:, 1 + registers.shape[1] :]

    def positions(self, grid: tuple[int, int]) -> Float[Tensor, "1 L C"]:
        """Position embeddings of the class token and of a grid, resampled from the stored one where it differs."""
        if grid == (self.grid, self.grid):
            return self.pos_embed
        stored = self.pos_embed[:, 1:].float().mT.unflatten(2, (self.grid, self.grid))
        resampled = F.interpolate(stored, size=grid, mode="bicubic", antialias=True)
        return torch.cat([self.pos_embed[:, :1].float(), resampled.flatten(2).mT], dim=1)


class Patches(nn.Module):
    """A linear embedding of patches, with no transformer behind it."""

    def __init__(self, *, dim: int, patch_size: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(3, dim, patch_size, stride=patch_size)

    def forward(self, images: Float[Tensor, "M 3 H W"]) -> Float[Tensor, "M p C"]:
        """Embed normalised images, patches in row-major order."""
        return self.conv(images).flatten(2).mT


class Embedder(contracts.Embedder):
    """Patch tokens of each view behind a camera token and register tokens.

    The reference view has camera and register tokens of its own; all others share theirs.

    Options are explained at :class:`~anystyle_backbones.anysplat.AnySplat`. ``grid`` is in patches.
    """

    def __init__(
        self,
        *,
        embed: Literal["dino", "conv"],
        dim: int,
        depth: int,
        heads: int,
        mlp_ratio: float,
        registers: int,
        patch_size: int,
        grid: int,
        reference: Strategy,
    ) -> None:
        super().__init__()
        self.patch_size = patch_size
        self.reference: Strategy = reference
        self.patches = (
            DinoV2(dim=dim, depth=depth, heads=heads, patch_size=patch_size, grid=grid, mlp_ratio=mlp_ratio)
            if embed == "dino"
            else Patches(dim=dim, patch_size=patch_size)
        )
        self.camera_token = nn.Parameter(torch.empty(1, 2, 1, dim))
        self.register_token = nn.Parameter(torch.empty(1, 2, registers, dim))
        nn.init.normal_(self.camera_token, std=1e-6)
        nn.init.normal_(self.register_token, std=1e-6)

    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        batch, views = images.shape[:2]
        grid = grid_of(images, self.patch_size)
        pixels = normalised(images.to(self.camera_token.dtype))
        patches = self.patches(pixels.flatten(0, 1)).unflatten(0, (batch, views))
        tokens = Tokens(patches, grid, reference=reference_view(images, patches.mean(2), self.reference))
        special = torch.cat([self.camera_token, self.register_token], dim=2)[0]  # 2 special C
        special = special[1 - is_reference(tokens).long()].to(patches.dtype)  # B V special C
        return replace(tokens, data=torch.cat([special, patches], dim=2), special=special.shape[2])


class Aggregator(contracts.Aggregator):
    """Pairs of a frame block, which sees one view, and a global block, which sees all.

    Style may enter ahead of every pair, on the residual stream; the published method uses the first layer and those
    that heads read. A tapped feature is the outputs of both blocks of the layer, side by side in the channels.

    Options are explained at :class:`~anystyle_backbones.anysplat.AnySplat`.
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
