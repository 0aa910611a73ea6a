"""One transformer: an embedder of single views, and later blocks whose attention alternates."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from math import isqrt

import torch
from jaxtyping import Float
from torch import Tensor, nn

from anystyle import contracts
from anystyle.nn.attention import Block
from anystyle.nn.tokens import grid_of, grid_positions, normalised, rotary
from anystyle.types import Features, Inject, Site, Tokens, untouched
from anystyle_backbones.blocks import run, start_as_dino, with_norms
from anystyle_backbones.heads import positions
from anystyle_backbones.reference_view import Strategy, is_reference, reference_view

OFFSET = 0.1
"""Added to the sides of a grid of patches where position embeddings are resampled, as DINOv2 was trained."""


def patch_tokens(
    images: Float[Tensor, "B V 3 H W"],
    proj: nn.Conv2d,
    cls_token: Float[Tensor, "1 1 C"],
    pos_embed: Float[Tensor, "1 L C"],
) -> Tokens:
    """Class token and patches of sRGB images in [0, 1], with positions added."""
    batch, views = images.shape[:2]
    grid = grid_of(images, proj.kernel_size[0])
    patches = proj(normalised(images.to(proj.weight.dtype)).flatten(0, 1)).flatten(2).mT
    cls = cls_token.to(patches.dtype).expand(batch * views, -1, -1)
    scale = [(length + OFFSET) / isqrt(pos_embed.shape[1] - 1) for length in grid]
    tokens = torch.cat([cls, patches], dim=1) + positions(pos_embed, grid, scale_factor=scale).to(patches.dtype)
    return Tokens(tokens.unflatten(0, (batch, views)), grid=grid, special=1)


def by_view(function: Callable[[Tensor], Tensor], data: Float[Tensor, "B V P C"]) -> Float[Tensor, "B V P C"]:
    """Apply a function to the tokens of each view."""
    return function(data.flatten(0, 1)).unflatten(0, (-1, data.shape[1]))


class Embedder(contracts.Embedder):
    """DINOv2's blocks up to the first alternating one, reference-view selection and camera tokens.

    Ahead of its last block the reference view is chosen. In the stem a camera token has taken the place of the class
    token: the reference has one of its own, all other views share theirs.

    Options are explained at :class:`~anystyle_backbones.depth_anything.DepthAnything`. ``grid`` is in patches.
    """

    def __init__(self, dim: int, blocks: Iterable[Block], *, patch_size: int, grid: int, reference: Strategy) -> None:
        super().__init__()
        self.patch_size, self.grid = patch_size, grid
        self.reference: Strategy = reference
        self.proj = nn.Conv2d(3, dim, patch_size, stride=patch_size)
        self.cls_token = nn.Parameter(torch.empty(1, 1, dim))
        self.camera_token = nn.Parameter(torch.empty(1, 2, dim))
        self.pos_embed = nn.Parameter(torch.empty(1, 1 + grid**2, dim))
        self.blocks = nn.ModuleList(blocks)
        nn.init.normal_(self.cls_token, std=1e-6)
        nn.init.normal_(self.camera_token, std=0.02)
        nn.init.trunc_normal_(self.pos_embed, std=0.02)
        start_as_dino(self.blocks)

    def forward(self, images: Float[Tensor, "B V 3 H W"]) -> Tokens:
        """Embed sRGB images in [0, 1]."""
        tokens = patch_tokens(images, self.proj, self.cls_token, self.pos_embed)
        for block in self.blocks[:-1]:
            tokens = tokens.with_data(by_view(block, tokens.data))
        tokens = replace(tokens, reference=reference_view(images, tokens.data[:, :, 0], self.reference))
        tokens = tokens.with_data(by_view(self.blocks[-1], tokens.data))
        camera = torch.where(is_reference(tokens)[..., None], *self.camera_token[0]).to(tokens.data.dtype)
        return tokens.with_data(torch.cat([camera[:, :, None], tokens.patches], dim=2))


class Aggregator(contracts.Aggregator):
    """Blocks that attend across all views where their index in the trunk is odd, and within each view where it is even.

    Style may enter ahead of every block, on the residual stream. Marked as tapped are the first block and, for each
    layer that heads read, the local block whose output is the first half of what they read, so that style is in both
    halves. A tapped feature is the last local block's output and the normalised stream, side by side in the channels;
    its leading token, which cameras are read off, is not normalised.

    Options are explained at :class:`~anystyle_backbones.depth_anything.DepthAnything`; ``blocks`` are by their index in
    the trunk, the first being ``alternate_from``.
    """

    def __init__(
        self, dim: int, blocks: Mapping[int, Block], *, rope_base: float, taps: Sequence[int], checkpointing: bool
    ) -> None:
        super().__init__()
        self.dim, self.rope_base, self.checkpointing = dim, rope_base, checkpointing
        self.layers, self.taps = tuple(blocks), tuple(taps)
        self.head_dim = dim // blocks[self.layers[0]].attn.heads
        self.blocks = nn.ModuleDict({str(layer): block for layer, block in blocks.items()})
        self.norm = nn.LayerNorm(dim)
        start_as_dino(self.blocks)

    @property
    def sites(self) -> tuple[Site, ...]:
        """``aggregator/<block>``, ahead of every block."""
        tapped = {self.layers[0], *(max(self.layers[0], layer - layer % 2) for layer in self.taps)}
        return tuple(Site(f"aggregator/{layer}", self.dim, tapped=layer in tapped) for layer in self.layers)

    def forward(self, stem: Tokens, inject: Inject = untouched) -> Features:
        """Turn the stem into tapped features."""
        views = stem.data.shape[1]
        places = grid_positions(stem.grid, stem.special, stem.data.device)
        # Across views, as published: the leading token is at (0, 0), every patch at (1, 1).
        turned = partial(rotary, dim=self.head_dim, base=self.rope_base, like=stem.data)
        angles = [with_norms(self.blocks.values(), turned(each)) for each in (places, places.clamp_max(1))]
        apply = partial(run, recompute=self.checkpointing and self.training)
        tokens, local = stem, stem.data
        features: dict[int, Tokens] = {}
        for index, layer in enumerate(self.layers):
            tokens, block = inject(f"aggregator/{layer}", tokens), self.blocks[str(layer)]
            if layer % 2:
                joint = apply(block, tokens.data.flatten(1, 2), angles[1][index])  # B VP C
                tokens = tokens.with_data(joint.unflatten(1, (views, -1)))
            else:
                local = by_view(partial(apply, block, angles=angles[0][index]), tokens.data)
                tokens = tokens.with_data(local)
            if layer in self.taps:
                features[layer] = self._tapped(local, tokens)
        return features

    def _tapped(self, local: Float[Tensor, "B V P C"], tokens: Tokens) -> Tokens:
        leading = torch.cat([local[:, :, :1], tokens.data[:, :, :1]], dim=-1)
        patches = torch.cat([local[:, :, 1:], self.norm(tokens.patches)], dim=-1)
        return tokens.with_data(torch.cat([leading, patches], dim=2))
